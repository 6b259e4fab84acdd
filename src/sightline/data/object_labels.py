"""Conversion of labels between KITTI's columns and the types of the project."""

import numpy as np
import torch
from torch import Tensor

from sightline.data.kitti_labels import NO_LOCATION, NO_ROTATION, NO_SIZE, KittiObjects
from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.boxes3d import Boxes3D, boxes3d_from_kitti, kitti_from_boxes3d
from sightline.geometry.calibration import Calibration
from sightline.structures.labels import ObjectLabels


def labels_from_kitti(objects: KittiObjects, calibration: Calibration) -> ObjectLabels:
    """Convert the objects of a label file, with boxes in the LiDAR frame, in float64.

    An object without a 3D part (KITTI's placeholders, or a size that is not positive) gets a row
    of zeros. Scores are left out.
    """
    dimensions_hwl, locations = _tensor(objects.dimensions_hwl), _tensor(objects.locations)
    has_box3d = (dimensions_hwl > 0).all(dim=1) & (locations != NO_LOCATION).any(dim=1)
    boxes3d = boxes3d_from_kitti(
        dimensions_hwl, locations, _tensor(objects.rotation_y), calibration.camera_from_lidar
    )
    return ObjectLabels(
        class_names=objects.class_names,
        boxes2d=Boxes2D(_tensor(objects.boxes2d)),
        boxes3d=Boxes3D(torch.where(has_box3d[:, None], boxes3d.tensor, 0.0)),
        truncation=_tensor(objects.truncation),
        occlusion=_tensor(objects.occlusion).long(),
        alpha=_tensor(objects.alpha),
    )


def kitti_from_labels(labels: ObjectLabels, calibration: Calibration) -> KittiObjects:
    """Convert labels to the columns of a label file: the inverse of `labels_from_kitti`.

    An object without a 3D part gets KITTI's placeholders; rotation_y is in [-pi, pi).
    """
    boxes3d = Boxes3D(labels.boxes3d.tensor.double())
    dimensions_hwl, locations, rotation_y = kitti_from_boxes3d(
        boxes3d, calibration.camera_from_lidar
    )
    has_box3d = labels.has_box3d
    return KittiObjects(
        class_names=labels.class_names,
        truncation=labels.truncation.numpy(),
        occlusion=labels.occlusion.double().numpy(),
        alpha=labels.alpha.numpy(),
        boxes2d=labels.boxes2d.tensor.double().numpy(),
        dimensions_hwl=torch.where(has_box3d[:, None], dimensions_hwl, NO_SIZE).numpy(),
        locations=torch.where(has_box3d[:, None], locations, NO_LOCATION).numpy(),
        rotation_y=torch.where(has_box3d, rotation_y, NO_ROTATION).numpy(),
    )


def _tensor(column: np.ndarray) -> Tensor:
    # A copy: PyTorch warns of the read-only columns of a file.
    return torch.tensor(column)

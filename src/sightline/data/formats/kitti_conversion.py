"""Conversion of labels and detections between KITTI's columns and the types of the project."""

import math
from typing import Final

import numpy as np
import torch
from jaxtyping import Float64
from torch import Tensor

from sightline.data.formats.kitti_labels import (
    NO_ALPHA,
    NO_LOCATION,
    NO_ROTATION,
    NO_SIZE,
    UNKNOWN,
    KittiObjects,
)
from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.boxes3d import Boxes3D, boxes3d_from_kitti, kitti_from_boxes3d
from sightline.geometry.calibration import Calibration
from sightline.geometry.image_boxes import kitti_corners, project_boxes
from sightline.geometry.transforms import transform_points, wrap_angle
from sightline.structures.labels import ObjectLabels
from sightline.structures.predictions import Detections2D, Detections3D

_UPRIGHT_COSINE: Final = math.cos(math.radians(1.0))
"""Cosine of the tilt up to which boxes are drawn upright in the camera's frame, as in KITTI's own
files; its cars' cameras are tilted by up to 0.86 degrees against the LiDAR."""


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


def kitti_from_detections(
    found: Detections2D | Detections3D,
    calibration: Calibration,
    image_size: tuple[int, int],
    *,
    keeps_unseen: bool = False,
) -> KittiObjects:
    """Convert detections inside the image to the columns of a frame's result file.

    Detections outside the image are left out, because KITTI neither labels nor scores them; with
    `keeps_unseen`, 3D detections there have a 2D box of -1. The rest keeps its order. Truncation
    and occlusion are unknown (-1).

    * 2D detections: boxes are clipped to the image; there is no 3D part and no alpha.
    * 3D detections: the 2D box bounds the 3D box's edges within the image (`project_boxes`), and
      alpha is rotation_y minus the bearing of the box's centre. rotation_y neglects the tilt
      between the sensors, as in labels. The 3D box projected is upright in the camera's frame, as
      KITTI's labels are, if the camera is tilted by up to 1 degree against the LiDAR; if by more,
      it is the box in the LiDAR's frame.

    Args:
        found: Detections in the LiDAR frame, or in the image.
        calibration: Calibration of the frame.
        image_size: Height, width [px] of its image.
        keeps_unseen: Whether 3D detections outside the image are kept.
    """
    if isinstance(found, Detections2D):
        return kitti_from_detections2d(found, image_size)
    boxes = Boxes3D(found.boxes.tensor.detach().cpu().double())
    dimensions_hwl, locations, rotation_y = kitti_from_boxes3d(boxes, calibration.camera_from_lidar)
    upright = -calibration.camera_from_lidar[1, 2]  # of the LiDAR's z axis along the camera's
    if float(upright) > _UPRIGHT_COSINE:
        corners = kitti_corners(dimensions_hwl, locations, rotation_y)
    else:
        corners = transform_points(calibration.camera_from_lidar, boxes.corners())
    boxes2d = project_boxes(corners, calibration.image_from_camera, image_size).tensor
    bearing = torch.atan2(locations[:, 0], locations[:, 2])
    is_seen = ~boxes2d.isnan().any(dim=1)
    return _results(
        found,
        torch.ones_like(is_seen) if keeps_unseen else is_seen,
        boxes2d=torch.where(is_seen[:, None], boxes2d, UNKNOWN),
        dimensions_hwl=dimensions_hwl,
        locations=locations,
        rotation_y=rotation_y,
        alpha=wrap_angle(rotation_y - bearing),
    )


def kitti_from_detections2d(found: Detections2D, image_size: tuple[int, int]) -> KittiObjects:
    """Convert 2D detections without a calibration; see `kitti_from_detections`."""
    boxes = found.boxes.to("cpu").clip(image_size)
    count = len(boxes)
    return _results(
        found,
        boxes.area() > 0,
        boxes2d=boxes.tensor,
        dimensions_hwl=torch.full((count, 3), NO_SIZE),
        locations=torch.full((count, 3), NO_LOCATION),
        rotation_y=torch.full((count,), NO_ROTATION),
        alpha=torch.full((count,), NO_ALPHA),
    )


def check_boxes(found: Detections2D | Detections3D) -> None:
    """Check detections before they are written, since invalid boxes would be taken as unseen.

    Raises:
        ValueError: A number of a box is not finite, x_max is below x_min or y_max below y_min, or
            a size in 3D is not positive.
    """
    boxes = found.boxes.tensor.detach().cpu()
    if isinstance(found, Detections2D):
        is_valid = (boxes[:, 2:] >= boxes[:, :2]).all(dim=1)
        expected = "finite x_min, y_min, x_max, y_max in pixels, the smaller first"
    else:
        is_valid = (boxes[:, 3:6] > 0).all(dim=1)
        expected = "finite x, y, z, length, width, height, yaw, sizes above 0"
    is_valid &= boxes.isfinite().all(dim=1)
    if not is_valid.all():
        number = int(is_valid.int().argmin())
        numbers = ", ".join(f"{each:g}" for each in boxes[number].tolist())
        raise ValueError(
            f"detection {number} of {len(boxes)} has the box {numbers}, expected {expected}; "
            "correct the predictor"
        )


def detections2d_from_kitti(objects: KittiObjects) -> Detections2D:
    """Convert the 2D boxes of a result file, in its order."""
    return Detections2D(
        class_names=objects.class_names,
        boxes=Boxes2D(torch.tensor(objects.boxes2d)),
        scores=torch.tensor(_scores_of(objects)),
    )


def detections3d_from_kitti(objects: KittiObjects, calibration: Calibration) -> Detections3D:
    """Convert the objects with a 3D part of a result file to the LiDAR frame, in its order."""
    labels = labels_from_kitti(objects, calibration)
    kept = labels.has_box3d.nonzero()[:, 0]
    return Detections3D(
        class_names=tuple(objects.class_names[index] for index in kept.tolist()),
        boxes=labels.boxes3d[kept],
        scores=torch.tensor(_scores_of(objects))[kept],
    )


def _scores_of(objects: KittiObjects) -> Float64[np.ndarray, " num_objects"]:
    assert objects.scores is not None, "result files have scores"
    return objects.scores


def _results(
    found: Detections2D | Detections3D, is_shown: Tensor, **columns: Tensor
) -> KittiObjects:
    kept = is_shown.nonzero()[:, 0]
    unknown = torch.full((len(found.scores),), UNKNOWN)
    columns |= {"truncation": unknown, "occlusion": unknown, "scores": found.scores.detach().cpu()}
    arrays = {name: column[kept].double().numpy(force=True) for name, column in columns.items()}
    names = tuple(found.class_names[index] for index in kept.tolist())
    return KittiObjects(class_names=names, **arrays)

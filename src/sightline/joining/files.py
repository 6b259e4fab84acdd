"""KITTI result files of joined objects."""

from pathlib import Path

import numpy as np
import torch

from sightline.data.formats import kitti_labels
from sightline.data.formats.kitti_labels import NO_ALPHA, NO_LOCATION, NO_ROTATION, NO_SIZE, UNKNOWN
from sightline.geometry.boxes3d import Boxes3D, kitti_from_boxes3d
from sightline.geometry.transforms import wrap_angle
from sightline.structures.level import level_calibration
from sightline.structures.objects import Objects
from sightline.structures.sample import CameraLidarSample


def kitti_from_objects(
    objects: Objects, sample: CameraLidarSample, *, in_space: bool = False
) -> kitti_labels.KittiObjects:
    """Convert objects inside the image to the columns of a result file, in their order.

    Objects without a 3D box get KITTI's placeholders.

    Args:
        objects: Objects of the frame, in the LiDAR's own frame.
        sample: The frame.
        in_space: Whether to keep only objects with a 3D box and give their 3D scores, for an
            evaluation in space; else all, with the scores of the objects.
    """
    chosen = objects.has_box2d & objects.has_box3d if in_space else objects.has_box2d
    objects = objects.select(chosen.nonzero()[:, 0])
    has_box3d = objects.has_box3d
    boxes = objects.boxes3d
    if sample.level_from_lidar is not None:
        boxes = boxes.to_level(sample.level_from_lidar)
    calibration = level_calibration(sample.calibration, sample.level_from_lidar)
    sizes, locations, rotation_y = kitti_from_boxes3d(
        Boxes3D(boxes.tensor.double()), calibration.camera_from_lidar
    )
    alpha = wrap_angle(rotation_y - torch.atan2(locations[:, 0], locations[:, 2]))
    unknown = np.full(len(objects), UNKNOWN)
    return kitti_labels.KittiObjects(
        class_names=objects.class_names,
        truncation=unknown,
        occlusion=unknown,
        alpha=torch.where(has_box3d, alpha, NO_ALPHA).numpy(),
        boxes2d=objects.boxes2d.tensor.numpy(),
        dimensions_hwl=torch.where(has_box3d[:, None], sizes, NO_SIZE).numpy(),
        locations=torch.where(has_box3d[:, None], locations, NO_LOCATION).numpy(),
        rotation_y=torch.where(has_box3d, rotation_y, NO_ROTATION).numpy(),
        scores=(objects.scores3d if in_space else objects.scores).numpy(),
    )


def write_objects(
    path: Path, sample: CameraLidarSample, objects: Objects, *, in_space: bool = False
) -> None:
    """Write KITTI's result file with both boxes of each object; see `kitti_from_objects`."""
    kitti_labels.write_objects(path, kitti_from_objects(objects, sample, in_space=in_space))

"""nuScenes' annotations as KITTI labels one camera's image."""

from collections.abc import Sequence
from typing import Final

import numpy as np
import torch
from jaxtyping import Float64

from sightline.data.calibration_text import CalibrationMatrices
from sightline.data.importing.frames import Rigid
from sightline.data.importing.nuscenes import Annotation
from sightline.data.kitti_boxes import ImageBox, box_corners, project_box
from sightline.data.kitti_labels import (
    NO_ALPHA,
    NO_LOCATION,
    NO_ROTATION,
    NO_SIZE,
    UNKNOWN,
    KittiObjects,
)
from sightline.geometry.boxes3d import Boxes3D, kitti_from_boxes3d

_CLASSES: Final = {
    "vehicle.car": "Car",
    "vehicle.emergency.police": "Car",
    "vehicle.emergency.ambulance": "Van",
    "vehicle.truck": "Truck",
    "vehicle.trailer": "Truck",
    "vehicle.construction": "Truck",
    "vehicle.bus": "Truck",
    "human.pedestrian": "Pedestrian",
    "vehicle.bicycle": "Cyclist",
    "vehicle.motorcycle": "Cyclist",
}
"""KITTI's class of each category, or of those that begin so; others are left out."""
_RIDDEN: Final = "cycle.with_rider"
_OCCLUSIONS: Final = {4: 0.0, 3: 1.0, 2: 1.0, 1: 2.0}  # by visibility; else unknown, 3
_DONT_CARE: Final = "DontCare"


def kitti_from_annotations(
    annotations: Sequence[Annotation],
    matrices: CalibrationMatrices,
    lidar_from_world: Rigid,
    image_size: tuple[int, int],
) -> KittiObjects:
    """The objects that the image shows, in their order.

    2D boxes are those of the 3D box's edges within the image, as KITTI has them. Buses and trailers
    are trucks, motorcycles are cycles; a cycle without a rider is Misc. What no LiDAR point fell
    on, so that nobody can be asked to find it, is a DontCare region.

    Args:
        annotations: In the world's frame.
        matrices: Of the frame.
        lidar_from_world: Where its sweep was taken.
        image_size: Height, width [px].
    """
    known = [(each, name) for each in annotations if (name := _class_of(each)) is not None]
    boxes = np.array([_box_in_lidar(each, lidar_from_world) for each, _ in known]).reshape(-1, 7)
    dimensions, locations, rotations = (
        column.numpy()
        for column in kitti_from_boxes3d(
            Boxes3D(torch.from_numpy(boxes)), torch.from_numpy(matrices.camera_from_lidar)
        )
    )
    seen = [
        project_box(
            box_corners(locations[index], dimensions[index], float(rotations[index])),
            matrices.image_from_camera,
            image_size,
        )
        for index in range(len(known))
    ]
    kept = [index for index, each in enumerate(seen) if _is_shown(each)]
    cared = np.array([known[index][0].num_lidar_points > 0 for index in kept], dtype=bool)
    bearing = np.arctan2(locations[kept, 0], locations[kept, 2])
    alpha = (rotations[kept] - bearing + np.pi) % (2 * np.pi) - np.pi
    occlusion = [_OCCLUSIONS.get(known[index][0].visibility, 3.0) for index in kept]
    truncation = np.array([seen[index].truncation for index in kept], dtype=np.float64)
    return KittiObjects(
        class_names=tuple(
            known[index][1] if is_cared else _DONT_CARE
            for index, is_cared in zip(kept, cared.tolist(), strict=True)
        ),
        truncation=np.where(cared, truncation, UNKNOWN),
        occlusion=np.where(cared, np.array(occlusion, dtype=np.float64), UNKNOWN),
        alpha=np.where(cared, alpha, NO_ALPHA),
        boxes2d=np.array([seen[index].box for index in kept]).reshape(-1, 4),
        dimensions_hwl=np.where(cared[:, None], dimensions[kept], NO_SIZE),
        locations=np.where(cared[:, None], locations[kept], NO_LOCATION),
        rotation_y=np.where(cared, rotations[kept], NO_ROTATION),
    )


def _class_of(annotation: Annotation) -> str | None:
    name = next(
        (name for begin, name in _CLASSES.items() if annotation.category.startswith(begin)), None
    )
    is_parked_cycle = name == "Cyclist" and _RIDDEN not in annotation.attributes
    return "Misc" if is_parked_cycle else name


def _box_in_lidar(annotation: Annotation, lidar_from_world: Rigid) -> Float64[np.ndarray, "7"]:
    """x, y, z, length, width, height, yaw; the small tilt of a box is neglected."""
    lidar_from_box = lidar_from_world @ annotation.world_from_box
    yaw = np.arctan2(lidar_from_box[1, 0], lidar_from_box[0, 0])
    return np.array((*lidar_from_box[:3, 3], *annotation.size_lwh, yaw))


def _is_shown(seen: ImageBox) -> bool:
    return bool(np.isfinite(seen.box).all() and (seen.box[2:] - seen.box[:2] >= 1).all())

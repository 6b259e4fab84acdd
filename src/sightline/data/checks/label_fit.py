"""Checks that labels, calibration and cloud belong to one frame."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Bool, Float32, Float64

from sightline.data.checks.label_checks import (
    doubt_about_boxes2d,
    doubts_in_space,
    is_empty_box2d,
    is_inside_out,
)
from sightline.data.checks.result_boxes import BOX2D_CONVENTIONS, image_ious
from sightline.data.formats.kitti_boxes import box_corners, project_box
from sightline.data.formats.kitti_calibration import CalibrationMatrices
from sightline.data.formats.kitti_labels import NO_LOCATION, KittiObjects
from sightline.data.layouts.kitti_trees import CORRUPTED
from sightline.files.problem import Problem

MIN_MEDIAN_IOU: Final = 0.4
"""Lowest median IoU of a sound file; KITTI's, with two objects or more, have 0.49 or more."""
_MIN_CAUSE_IOU: Final = 0.6
"""Median IoU from which another convention is named as the cause."""
_MIN_OBJECTS: Final = 2
_MAX_OBJECTS: Final = 100  # checked objects per file
MAX_FILLED_RANGE_M: Final = 25.0
"""Range within which a LiDAR hits every object that is at most partly hidden: on 90 real frames, 1
of 255 such objects within 40 m has no point in its box."""
_MIN_FILLED_SHARE: Final = 0.75
"""Share of those objects with points from which another frame is named as the cause."""
_VISIBLE_OCCLUSIONS: Final = (0.0, 1.0)  # visible, partly hidden
_REGION: Final = "DontCare"


def check_label_fit(
    objects: KittiObjects,
    matrices: CalibrationMatrices,
    size: tuple[int, int] | None,
    points: Float32[np.ndarray, "num_points 4"] | None,
    path: Path,
) -> list[Problem]:
    """Find labels whose 3D boxes do not fit the 2D boxes or the points.

    Corrupted trees are not checked: their parts disagree on purpose. Nor are boxes in units or an
    order that `check_objects` doubts.

    Args:
        objects: Labels of the frame.
        matrices: Calibration of the frame.
        size: Height and width of the image; None, if unknown: they end where the 2D boxes do.
        points: Cloud of the frame; None or empty: the LiDAR delivered nothing.
        path: File of the labels.
    """
    if (path.parent.parent / CORRUPTED).is_dir() or doubts_in_space(objects):
        return []
    is_misread = doubt_about_boxes2d(objects, size) is not None
    misplaced = [] if is_misread else _check_image(objects, matrices, size, path)
    if misplaced or points is None or not len(points):
        return misplaced
    return _check_cloud(objects, matrices, points, path)


def visible_objects(objects: KittiObjects, *, within_m: float) -> list[int]:
    """Indices of the objects with a 3D box near the camera that are at most partly hidden."""
    is_near = np.linalg.norm(objects.locations, axis=1) < within_m
    is_chosen = _has_box3d(objects) & is_near & np.isin(objects.occlusion, _VISIBLE_OCCLUSIONS)
    chosen: list[int] = np.flatnonzero(is_chosen)[:_MAX_OBJECTS].tolist()
    return chosen


def heights_in_column(
    objects: KittiObjects,
    index: int,
    xyz: Float64[np.ndarray, "num_points 3"],
    *,
    margin_m: float = 0.0,
) -> Float64[np.ndarray, " num_inside"]:
    """Heights over an object's bottom [m] of the points that lie in, over or under its 3D box.

    Args:
        objects: All objects of the frame.
        index: Index of the object.
        xyz: Points in the camera's frame [m].
        margin_m: Margin around the box that is included [m].
    """
    _, width, length = objects.dimensions_hwl[index]
    x, y, z = (xyz - objects.locations[index]).T
    cos, sin = np.cos(objects.rotation_y[index]), np.sin(objects.rotation_y[index])
    is_along = np.abs(cos * x - sin * z) <= length / 2 + margin_m
    is_across = np.abs(sin * x + cos * z) <= width / 2 + margin_m
    return np.asarray(-y[is_along & is_across])


def _has_box3d(objects: KittiObjects) -> Bool[np.ndarray, " num_objects"]:
    names = np.array(objects.class_names, dtype=object)
    has_box3d = (objects.locations != NO_LOCATION).any(axis=1) & (names != _REGION)
    return np.asarray(has_box3d & (objects.dimensions_hwl > 0).all(axis=1))


def _check_image(
    objects: KittiObjects,
    matrices: CalibrationMatrices,
    size: tuple[int, int] | None,
    path: Path,
) -> list[Problem]:
    is_drawn = ~is_empty_box2d(objects.boxes2d) & ~is_inside_out(objects.boxes2d)
    chosen = np.flatnonzero(_has_box3d(objects) & is_drawn)[:_MAX_OBJECTS].tolist()
    if len(chosen) < _MIN_OBJECTS:
        return []
    if size is None:
        right, bottom = np.ceil(objects.boxes2d[:, 2:].max(axis=0)).astype(int) + 1
        size = max(int(bottom), 1), max(int(right), 1)
    boxes2d = objects.boxes2d[chosen]
    projected = _projections(objects, chosen, matrices, size)
    median = _median_iou(projected, boxes2d)
    if median >= MIN_MEDIAN_IOU:
        return []
    medians = {
        f"2D boxes are {name}": _median_iou(projected, convert(boxes2d))
        for name, convert in BOX2D_CONVENTIONS.items()
    }
    for name, changed in _other_boxes3d(objects, matrices).items():
        medians[name] = _median_iou(_projections(changed, chosen, matrices, size), boxes2d)
    best = max(medians, key=lambda name: medians[name])
    cause = (
        f"; if {best}, it is {100 * medians[best]:.0f} %" if medians[best] >= _MIN_CAUSE_IOU else ""
    )
    return [
        Problem(
            path=path,
            problem=f"has 3D boxes whose projections do not fit its 2D boxes: the median IoU of "
            f"{len(chosen)} objects is {100 * median:.0f} %, expected at least "
            f"{100 * MIN_MEDIAN_IOU:.0f} %{cause}",
            remedy="give labels and calibration of the same camera and image size, the "
            "centre of each box's bottom in the camera's frame (x right, y down, z forward), and "
            "rotation_y about y",
        )
    ]


def _median_iou(
    projected: Float64[np.ndarray, "num_boxes 4"], boxes2d: Float64[np.ndarray, "num_boxes 4"]
) -> float:
    return float(np.median(image_ious(projected, boxes2d)))


def _projections(
    objects: KittiObjects, chosen: list[int], matrices: CalibrationMatrices, size: tuple[int, int]
) -> Float64[np.ndarray, "num_boxes 4"]:
    return np.stack(
        [
            project_box(_corners(objects, index), matrices.image_from_camera, size).box
            for index in chosen
        ]
    )


def _other_boxes3d(objects: KittiObjects, matrices: CalibrationMatrices) -> dict[str, KittiObjects]:
    """Convert 3D boxes of other conventions, by their name, the rest of a clause."""
    half_height = np.array((0, 0.5, 0)) * objects.dimensions_hwl[:, :1]
    return {
        "y is the height of box centres": replace(
            objects, locations=objects.locations + half_height
        ),
        **{name: read(objects, matrices) for name, read in LIDAR_FRAMES.items()},
        "sizes are halves": replace(objects, dimensions_hwl=2 * objects.dimensions_hwl),
    }


def _from_lidar(
    objects: KittiObjects, matrices: CalibrationMatrices, *, heights: float, is_yaw: bool
) -> KittiObjects:
    """Convert 3D boxes from the LiDAR's frame to the camera's.

    Args:
        objects: Objects with boxes in the LiDAR's frame.
        matrices: Calibration of the frame.
        heights: Part of an object's height from its bottom to its location.
        is_yaw: Whether rotation_y is the yaw in the LiDAR's frame.
    """
    camera_from_lidar = matrices.camera_from_lidar
    locations = objects.locations @ camera_from_lidar[:3, :3].T + camera_from_lidar[:3, 3]
    locations[:, 1] += heights * objects.dimensions_hwl[:, 0]
    turned = -objects.rotation_y - np.pi / 2 if is_yaw else objects.rotation_y
    return replace(objects, locations=locations, rotation_y=turned)


_IN_LIDAR: Final = "x, y, z are in the LiDAR's frame"
LIDAR_FRAMES: Final = {
    f"{_IN_LIDAR} and rotation_y is its yaw, of box centres": partial(
        _from_lidar, heights=0.5, is_yaw=True
    ),
    f"{_IN_LIDAR} and rotation_y is its yaw, of box bottoms": partial(
        _from_lidar, heights=0.0, is_yaw=True
    ),
    _IN_LIDAR: partial(_from_lidar, heights=0.0, is_yaw=False),
}
"""Conversions of boxes written in the LiDAR's frame, by their clause."""


def _check_cloud(
    objects: KittiObjects,
    matrices: CalibrationMatrices,
    points: Float32[np.ndarray, "num_points 4"],
    path: Path,
) -> list[Problem]:
    num_empty, num_near = count_empty_boxes(objects, matrices, points)
    if num_empty < _MIN_OBJECTS or 2 * num_empty < num_near:
        return []
    others = [
        count_empty_boxes(read(objects, matrices), matrices, points)
        for read in LIDAR_FRAMES.values()
    ]
    num_filled, of_near = max((near - empty, near) for empty, near in others)
    is_clear = num_filled >= _MIN_FILLED_SHARE * max(of_near, num_near)
    cause = f"; if {_IN_LIDAR}, {num_filled} of {of_near} have some" if is_clear else ""
    return [
        Problem(
            path=path,
            problem=f"has {num_empty} of {num_near} objects within {MAX_FILLED_RANGE_M:.0f} m "
            f"that are at most partly hidden but have no point of the cloud in their 3D box{cause}",
            remedy="give labels, cloud and calibration of one frame, the cloud in metres, x "
            "forward, y left, z up",
        )
    ]


def count_empty_boxes(
    objects: KittiObjects,
    matrices: CalibrationMatrices,
    points: Float32[np.ndarray, "num_points 4"],
) -> tuple[int, int]:
    """Count the near objects, at most partly hidden, without a point in their box; and all such."""
    chosen = visible_objects(objects, within_m=MAX_FILLED_RANGE_M)
    camera_from_lidar = matrices.camera_from_lidar
    xyz = points[:, :3] @ camera_from_lidar[:3, :3].T + camera_from_lidar[:3, 3]
    num_empty = 0
    for index in chosen:
        heights = heights_in_column(objects, index, xyz)
        is_inside = (heights >= 0) & (heights <= objects.dimensions_hwl[index, 0])
        num_empty += not is_inside.any()
    return num_empty, len(chosen)


def _corners(objects: KittiObjects, index: int) -> Float64[np.ndarray, "8 3"]:
    return box_corners(
        objects.locations[index], objects.dimensions_hwl[index], float(objects.rotation_y[index])
    )

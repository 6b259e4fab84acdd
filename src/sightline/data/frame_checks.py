"""Whether the files of one frame can be read, hold plausible values and fit each other."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
from jaxtyping import Float32

from sightline.data.calibration_checks import check_intrinsics, check_matrices
from sightline.data.calibration_text import (
    CalibrationMatrices,
    read_intrinsics,
    read_object_matrices,
    read_rectified_intrinsics,
)
from sightline.data.depth_png import read_depth_png
from sightline.data.depth_tree import DepthFrame
from sightline.data.drive_tree import DriveFrame
from sightline.data.image_file import read_rgb
from sightline.data.kitti_labels import NO_LOCATION, KittiObjects, read_labels
from sightline.data.object_tree import ObjectFrame
from sightline.data.problem import FileError, Problem
from sightline.data.velodyne import read_sweep
from sightline.data.view import is_in_view
from sightline.geometry.mount import MAX_RANGE_M

_OUTSIDE_SHARE = 0.1  # of the image's size, by which a box may reach over its edge
_MAX_ANGLE = np.pi + 0.01  # KITTI rounds to two digits
_OCCLUSIONS = (-1, 0, 1, 2, 3)

Content = TypeVar("Content")


def check_object_frame(frame: ObjectFrame) -> list[Problem]:
    """Checks one frame of the object tree; parts that are absent are not spoken of."""
    problems: list[Problem] = []
    size = _image_size(frame.image, problems)
    depth_m = read_or_note(read_depth_png, frame.depth, problems)
    if depth_m is not None and frame.depth is not None:
        problems += _check_size(depth_m, frame.depth, size, frame.image)
        size = size or depth_m.shape
    matrices = read_or_note(read_object_matrices, frame.calibration, problems)
    if matrices is not None and frame.calibration is not None:
        problems += check_matrices(matrices, size, frame.calibration)
    points = read_or_note(read_sweep, frame.points, problems)
    objects = read_or_note(read_labels, frame.objects, problems)
    if points is not None and frame.points is not None:
        problems += _check_points(points, frame.points)
        if size is not None and matrices is not None:
            problems += _check_view(points, matrices, size, frame.points)
    if objects is not None and frame.objects is not None:
        problems += check_objects(objects, size, frame.objects)
    return problems


def check_depth_frame(frame: DepthFrame) -> list[Problem]:
    """Checks one frame of the depth benchmark; parts that are absent are not spoken of."""
    problems: list[Problem] = []
    size = _image_size(frame.image, problems)
    for path in (frame.sparse, frame.truth):
        depth_m = read_or_note(read_depth_png, path, problems)
        if depth_m is None or path is None:
            continue
        problems += _check_size(depth_m, path, size, frame.image)
        if path == frame.truth and not depth_m.any():
            problems.append(Problem(path=path, problem="holds no depth", remedy="extract it again"))
    if frame.camera is None:
        intrinsics = read_or_note(read_intrinsics, frame.intrinsics, problems)
    else:
        read = partial(read_rectified_intrinsics, camera=int(frame.camera[-2:]))
        intrinsics = read_or_note(read, frame.intrinsics, problems)
    if intrinsics is not None and frame.intrinsics is not None:
        problems += check_intrinsics(intrinsics, size, frame.intrinsics)
    return problems


def check_drive_frame(frame: DriveFrame) -> list[Problem]:
    """Checks one moment of a raw drive; parts that are absent are not spoken of."""
    problems: list[Problem] = []
    _image_size(frame.image, problems)
    points = read_or_note(read_sweep, frame.points, problems)
    if points is not None and frame.points is not None:
        problems += _check_points(points, frame.points)
    return problems


def read_or_note(
    reader: Callable[[Path], Content], path: Path | None, problems: list[Problem]
) -> Content | None:
    """What the reader makes of the file; where it refuses it, None and one problem more."""
    if path is None:
        return None
    try:
        return reader(path)
    except FileError as error:
        problems.append(error.problem)
        return None


def _image_size(path: Path | None, problems: list[Problem]) -> tuple[int, int] | None:
    image = read_or_note(read_rgb, path, problems)
    return None if image is None else (image.shape[0], image.shape[1])


def _check_size(
    depth_m: Float32[np.ndarray, "height width"],
    path: Path,
    size: tuple[int, int] | None,
    image: Path | None,
) -> list[Problem]:
    """That a depth map is of another size than its image, where there is one."""
    if size is None or depth_m.shape == size:
        return []
    return [
        Problem(
            path=path,
            problem=f"is {depth_m.shape[0]}x{depth_m.shape[1]} (height x width) but the image "
            f"{image} is {size[0]}x{size[1]}",
            remedy="extract both again, or crop them alike",
        )
    ]


def _check_points(points: Float32[np.ndarray, "num_points 4"], path: Path) -> list[Problem]:
    problems = []
    squared_range = np.square(points[:, :3].astype(np.float64)).sum(axis=1)
    far = np.count_nonzero(squared_range > MAX_RANGE_M**2)
    if far:
        problems.append(
            Problem(
                path=path,
                problem=f"holds {far} of {len(points)} points farther away than "
                f"{MAX_RANGE_M:.0f} m, up to {np.sqrt(squared_range.max()):.4g} m",
                remedy="check that it is in metres, four float32 values a point",
            )
        )
    reflectance = points[:, 3]
    outside = np.count_nonzero((reflectance < 0) | (reflectance > 1))
    if outside:
        problems.append(
            Problem(
                path=path,
                problem=f"holds {outside} of {len(points)} reflectances outside 0 to 1, from "
                f"{reflectance.min():.4g} to {reflectance.max():.4g}",
                remedy="scale them to 0 to 1",
            )
        )
    return problems


def _check_view(
    points: Float32[np.ndarray, "num_points 4"],
    matrices: CalibrationMatrices,
    size: tuple[int, int],
    path: Path,
) -> list[Problem]:
    image_from_lidar = matrices.image_from_camera @ matrices.camera_from_lidar
    if is_in_view(points, image_from_lidar, size).any() or not len(points):
        return []
    return [
        Problem(
            path=path,
            problem=f"none of its {len(points)} points falls into the image",
            remedy="check that sweep and calibration belong together and that x points forward",
        )
    ]


def check_objects(objects: KittiObjects, size: tuple[int, int] | None, path: Path) -> list[Problem]:
    """Doubts about labels; `size` is the image's height and width, where it is known."""
    width_height = np.array([np.inf, np.inf] if size is None else [size[1], size[0]])
    minima, maxima = objects.boxes2d[:, :2], objects.boxes2d[:, 2:]
    margin = _OUTSIDE_SHARE * width_height
    has_box3d = (objects.locations != NO_LOCATION).any(axis=1)
    rotations = np.stack((objects.rotation_y, objects.alpha), axis=1)
    faults = {
        "has a 2D box with its maximum below its minimum": (maxima < minima).any(axis=1),
        "has a 2D box far outside the image": (
            (minima < -margin) | (maxima > width_height + margin)
        ).any(axis=1),
        "has a 3D box of a size that is not positive": has_box3d
        & (objects.dimensions_hwl <= 0).any(axis=1),
        "has an angle outside -pi to pi": has_box3d & (np.abs(rotations) > _MAX_ANGLE).any(axis=1),
        "has an occlusion other than -1 to 3": ~np.isin(objects.occlusion, _OCCLUSIONS),
    }
    return [
        Problem(
            path=path,
            problem=f"object {index + 1} of {len(objects)} ({objects.class_names[index]}) {fault}",
            remedy="correct the line or extract the labels again",
        )
        for fault, faulty in faults.items()
        for index in np.flatnonzero(faulty)
    ]

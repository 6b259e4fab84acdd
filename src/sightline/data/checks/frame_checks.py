"""Checks of one frame: files readable, values plausible, files consistent with each other."""

from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32, Float64, UInt8

from sightline.data.checks.label_checks import check_objects
from sightline.data.checks.label_fit import check_label_fit
from sightline.data.formats.image_file import read_rgb
from sightline.data.formats.image_header import read_image_size
from sightline.data.formats.kitti_calibration import (
    CalibrationMatrices,
    check_intrinsics,
    check_matrices,
    read_intrinsics,
    read_object_matrices,
    read_object_pose,
    read_rectified_intrinsics,
)
from sightline.data.formats.kitti_labels import read_labels
from sightline.data.formats.map_png import (
    MAX_DEPTH_M,
    MIN_HIGHEST_PX,
    MIN_HIGHEST_SHARE,
    NO_VALUE_REMEDY,
    read_depth_png,
)
from sightline.data.formats.pixels import is_in_view
from sightline.data.formats.velodyne import (
    doubtful_reflectances,
    hollow_sweep,
    read_sweep,
    sweep_doubt,
)
from sightline.data.layouts.kitti_trees import CORRUPTED, DepthFrame, DriveFrame, ObjectFrame
from sightline.files.problem import FileError, Problem, read_or_note
from sightline.geometry.mount import MAX_RANGE_M, has_too_few_in_image
from sightline.geometry.mount_axes import axes_doubt

_MAX_BLANK_LEVELS = 8  # largest range of levels in an image of a single colour
_MAX_BLANK_BYTES = 2048  # shorter files are decoded in any case
_MAX_BLANK_BYTES_PER_PX = 0.04  # one colour takes 0.005 as PNG, 0.03 as JPEG; pictures 0.08
_GREY_STEP = 4  # pixels between those that tell grey images
_MAX_LIDAR_DEPTH_M = 120.0  # largest plausible 99th percentile of a projected sweep
_MAX_DENSE_MEDIAN_M = 30.0  # of a dense map that goes beyond: simulated ones have up to 24
_DENSE_SHARE = 0.5  # pixels with a depth in a dense map
_MIN_DEPTH_M = 1.0  # smallest plausible 99th percentile
_MIN_COMPARED_PX = 20  # pixels with a depth and a point
_MAX_DEPTH_RATIO = 1.5  # ratio between depth and point that counts as a wrong scale
_CLOSE_SHARE = 0.1  # deviation of a depth from the point at its pixel, as a share of it
_MIN_CLOSE_PX = 100  # pixels with a depth and a point for this comparison
_MIN_CLOSE = 0.7  # share of close depths; 0.91 or more in each of 57 sound frames


@dataclass(kw_only=True, slots=True)
class Findings:
    """Faults of one frame by severity."""

    unreadable: list[Problem] = field(default_factory=list)
    """Files that their reader refuses."""
    impossible: list[Problem] = field(default_factory=list)
    """Impossible values, which make any prediction wrong."""
    implausible: list[Problem] = field(default_factory=list)
    """Implausible values, and files that probably do not belong together."""
    nearly_empty: list[Problem] = field(default_factory=list)
    """Clouds with hardly any points, which contradict no other file."""
    doubtful_intensities: list[Problem] = field(default_factory=list)
    """Clouds whose reflectances are probably of no use; their points are."""
    has_blank_image: bool = False
    """Whether the image has a single colour."""
    has_grey_image: bool = False
    """Whether the image has shades of grey alone."""
    has_empty_sweep: bool = False

    def all(self) -> list[Problem]:
        """Return all faults."""
        return [*self.unreadable, *self.impossible, *self.doubts()]

    def doubts(self) -> list[Problem]:
        """Return the faults that leave the frame usable."""
        return [*self.implausible, *self.nearly_empty, *self.doubtful_intensities]

    @property
    def is_consistent(self) -> bool:
        """Whether the frame's files are readable, plausible and fit each other."""
        return not (self.unreadable or self.impossible or self.implausible)


def examine_object_frame(frame: ObjectFrame) -> Findings:
    """Examine one frame of the object tree; absent parts are not reported."""
    found = Findings()
    size = _image_size(frame.image, found)
    depth_m = examine_depth(frame.depth, found)
    if depth_m is not None and frame.depth is not None:
        other_size = _check_size(depth_m, frame.depth, size, frame.image)
        found.implausible += other_size
        size = size or depth_m.shape
        depth_m = None if other_size else depth_m
    matrices = read_or_note(read_object_matrices, frame.calibration, found.unreadable)
    if matrices is not None and frame.calibration is not None:
        pose = read_or_note(read_object_pose, frame.calibration, found.unreadable)
        tilt = None if pose is None else pose.tilt
        found.implausible += check_matrices(
            matrices, size, frame.calibration, tilt=tilt, picture=frame.image
        )
    points = _examine_sweep(frame.points, found)
    objects = read_or_note(read_labels, frame.objects, found.unreadable)
    if points is not None and frame.points is not None and matrices is not None:
        axes_problems = _check_axes(points, matrices, frame.points)
        found.implausible += axes_problems or _check_view(points, matrices, size, frame.points)
        if not axes_problems and depth_m is not None and frame.depth is not None:
            image_from_lidar = matrices.image_from_camera @ matrices.camera_from_lidar
            found.implausible += check_depth_fit(depth_m, points, image_from_lidar, frame.depth)
    if objects is not None and frame.objects is not None:
        others_fit = found.is_consistent
        found.implausible += check_objects(objects, size, frame.objects)
        if matrices is not None and others_fit:
            found.implausible += check_label_fit(objects, matrices, size, points, frame.objects)
    return found


def examine_depth_frame(frame: DepthFrame) -> Findings:
    """Examine one frame of the depth benchmark; absent parts are not reported."""
    found = Findings()
    size = _image_size(frame.image, found)
    for path in (frame.sparse, frame.truth):
        depth_m = examine_depth(path, found, may_be_empty=path == frame.sparse)
        if depth_m is None or path is None:
            continue
        found.implausible += _check_size(depth_m, path, size, frame.image)
        found.implausible += _check_depth_range(depth_m, path)
        found.has_empty_sweep |= path == frame.sparse and not depth_m.any()
    if frame.camera is None:
        intrinsics = read_or_note(read_intrinsics, frame.intrinsics, found.unreadable)
    else:
        read = partial(read_rectified_intrinsics, camera=int(frame.camera[-2:]))
        intrinsics = read_or_note(read, frame.intrinsics, found.unreadable)
    if intrinsics is not None and frame.intrinsics is not None:
        found.implausible += check_intrinsics(
            intrinsics, size, frame.intrinsics, picture=frame.image
        )
    return found


def examine_drive_frame(
    frame: DriveFrame, *, matrices: CalibrationMatrices | None = None
) -> Findings:
    """Examine one frame of a raw drive with its calibration; absent parts are not reported."""
    found = Findings()
    size = _image_size(frame.image, found)
    points = _examine_sweep(frame.points, found)
    if points is not None and frame.points is not None and matrices is not None:
        axes_problems = _check_axes(points, matrices, frame.points)
        found.implausible += axes_problems or _check_view(points, matrices, size, frame.points)
    return found


def examine_image(path: Path | None, found: Findings) -> UInt8[np.ndarray, "height width 3"] | None:
    """Read an image; note if it is unreadable or has a single colour."""
    image = read_or_note(read_rgb, path, found.unreadable)
    if image is not None:
        found.has_blank_image = is_blank(image)
        few = image[::_GREY_STEP, ::_GREY_STEP]
        found.has_grey_image = not found.has_blank_image and bool((few == few[..., :1]).all())
    return image


def examine_depth(
    path: Path | None, found: Findings, *, may_be_empty: bool = False
) -> Float32[np.ndarray, "height width"] | None:
    """Read a depth map; note if it is unreadable, or holds no depth or a wrong sign for none."""
    depth_m = read_or_note(read_depth_png, path, found.unreadable)
    if depth_m is not None and path is not None and not (may_be_empty or depth_m.any()):
        remedy = "create it again, or remove it"
        found.implausible.append(Problem(path=path, problem="holds no depth", remedy=remedy))
    if depth_m is not None and path is not None:
        num_highest = int(np.count_nonzero(depth_m == MAX_DEPTH_M))
        if num_highest >= max(MIN_HIGHEST_PX, MIN_HIGHEST_SHARE * np.count_nonzero(depth_m)):
            problem = f"holds 65535 at {num_highest} pixels, probably for no value"
            found.implausible.append(Problem(path=path, problem=problem, remedy=NO_VALUE_REMEDY))
            depth_m = np.where(depth_m == MAX_DEPTH_M, np.float32(0), depth_m)
    return depth_m


def is_blank(image: UInt8[np.ndarray, "height width 3"]) -> bool:
    """Whether an image has a single colour, except for noise."""
    return int(image.max()) - int(image.min()) <= _MAX_BLANK_LEVELS


def is_blank_file(path: Path) -> bool:
    """Test if an image file has a single colour; files too long for that are not decoded."""
    try:
        num_bytes = path.stat().st_size
        if num_bytes > _MAX_BLANK_BYTES:
            height, width = read_image_size(path)
            if num_bytes > _MAX_BLANK_BYTES_PER_PX * height * width:
                return False
        return is_blank(read_rgb(path))
    except (FileError, OSError):
        return False


def _image_size(path: Path | None, found: Findings) -> tuple[int, int] | None:
    image = examine_image(path, found)
    return None if image is None else (image.shape[0], image.shape[1])


def _examine_sweep(
    path: Path | None, found: Findings
) -> Float32[np.ndarray, "num_points 4"] | None:
    points = read_or_note(read_sweep, path, found.unreadable)
    if points is None or path is None:
        return points
    found.has_empty_sweep = not len(points)
    doubt = sweep_doubt(path, points)
    if doubt is not None:
        found.impossible.append(doubt)
    else:
        found.implausible += _check_points(points, path)
        found.nearly_empty += hollow_sweep(path, points)
        if not found.nearly_empty:
            found.doubtful_intensities += doubtful_reflectances(path, points)
    return points


def _check_size(
    depth_m: Float32[np.ndarray, "height width"],
    path: Path,
    size: tuple[int, int] | None,
    image: Path | None,
) -> list[Problem]:
    """Check that a depth map has the size of its image, if there is one."""
    if size is None or depth_m.shape == size:
        return []
    return [
        Problem(
            path=path,
            problem=f"is {depth_m.shape[0]}x{depth_m.shape[1]} (height x width) but the image "
            f"{image} is {size[0]}x{size[1]}",
            remedy="extract both again, or crop both in the same way",
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
                remedy="check that it is in metres, four float32 values per point",
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


def _check_axes(
    points: Float32[np.ndarray, "num_points 4"], matrices: CalibrationMatrices, path: Path
) -> list[Problem]:
    """Check that the z axis of a cloud points up; otherwise other checks fail as a consequence."""
    axes = axes_doubt(points, matrices.camera_from_lidar)
    return [] if axes is None else [Problem(path=path, problem=axes[0], remedy=axes[1])]


def _check_view(
    points: Float32[np.ndarray, "num_points 4"],
    matrices: CalibrationMatrices,
    size: tuple[int, int] | None,
    path: Path,
) -> list[Problem]:
    """Check that the image shows a share of the cloud."""
    if size is None or not len(points):
        return []
    image_from_lidar = matrices.image_from_camera @ matrices.camera_from_lidar
    num_shown = int(np.count_nonzero(is_in_view(points, image_from_lidar, size)))
    if not has_too_few_in_image(num_shown, len(points)):
        return []
    shown = f"only {num_shown}" if num_shown else "none"
    return [
        Problem(
            path=path,
            problem=f"{shown} of its {len(points)} points fall{'' if num_shown > 1 else 's'} into "
            "the image",
            remedy="check that sweep and calibration belong together and that x points forward",
        )
    ]


def check_depth_fit(
    depth_m: Float32[np.ndarray, "height width"],
    points: Float32[np.ndarray, "num_points 4"],
    image_from_lidar: Float64[np.ndarray, "3 4"],
    path: Path,
) -> list[Problem]:
    """Check that scale and frame of a depth map agree with the points."""
    size = (depth_m.shape[0], depth_m.shape[1])
    shown = points[is_in_view(points, image_from_lidar, size), :3].astype(np.float64)
    projected = shown @ image_from_lidar[:, :3].T + image_from_lidar[:, 3]
    columns, rows = (projected[:, :2] / projected[:, 2:]).astype(int).T
    map_depths = depth_m[rows, columns]
    ratios = map_depths[map_depths > 0] / projected[map_depths > 0, 2]
    if len(ratios) < _MIN_COMPARED_PX:
        return []
    ratio = float(np.median(ratios))
    if not 1 / _MAX_DEPTH_RATIO <= ratio <= _MAX_DEPTH_RATIO:
        return [
            _wrong_scale(path, f"has {ratio:.3g} times the depths of the points at the same pixels")
        ]
    close = float(np.mean(np.abs(ratios - 1) < _CLOSE_SHARE))
    is_clear = close < _MIN_CLOSE and len(ratios) >= _MIN_CLOSE_PX
    if not is_clear or (path.parent.parent / CORRUPTED).is_dir():
        return []
    return [
        Problem(
            path=path,
            problem=f"agrees with the points at only {close:.0%} of {len(ratios)} common pixels",
            remedy="check that depth map, cloud and calibration are of the same frame",
        )
    ]


def _check_depth_range(depth_m: Float32[np.ndarray, "height width"], path: Path) -> list[Problem]:
    doubt = depth_range_doubt(depth_m)
    return [] if doubt is None else [_wrong_scale(path, doubt)]


def depth_range_doubt(depth_m: Float[np.ndarray, "height width"]) -> str | None:
    """Reason, as the rest of a sentence, why depths are no plausible metres; else None.

    Dense maps, of a simulator or a network, may go beyond the range of LiDARs.
    """
    depths = depth_m[depth_m > 0]
    if len(depths) < _MIN_COMPARED_PX:
        return None
    percentile_99 = float(np.percentile(depths, 99))
    if _MIN_DEPTH_M <= percentile_99 <= _MAX_LIDAR_DEPTH_M:
        return None
    is_dense = len(depths) > _DENSE_SHARE * depth_m.size
    if is_dense and percentile_99 > _MIN_DEPTH_M and np.median(depths) <= _MAX_DENSE_MEDIAN_M:
        return None
    return f"has a 99th percentile of depths of {percentile_99:.4g} m"


def _wrong_scale(path: Path, problem: str) -> Problem:
    return Problem(
        path=path,
        problem=f"{problem}: it is probably in millimetres or another unit, expected metres times "
        "256",
        remedy="write metres times 256 in 16 bits, 0 for no value",
    )

"""Corruptions of plain numpy arrays, without other classes of Sightline.

from sightline.corruptions.arrays import corrupt_arrays

found = corrupt_arrays("camera_fog", 3, image=image, points=points, image_from_camera=P2,
                       camera_from_lidar=Tr, name="000042")
found.image, found.points, found.camera_mask, found.record
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from operator import index
from typing import SupportsIndex

import numpy as np
import torch
from jaxtyping import Bool, Float32, Float64, Int64, Shaped, UInt8

from sightline.augmentation.faults import fault_rng
from sightline.corruptions.combined import find_corruption, needs_calibration
from sightline.corruptions.corruption import Corrupted, Record
from sightline.corruptions.sensor import HDL_64E, SpinningLidar
from sightline.data.checks.frame_checks import depth_range_doubt
from sightline.geometry.arguments import plain_size, plain_text, short_repr, wrong_type
from sightline.geometry.calibration import Calibration
from sightline.geometry.cloud_checks import cloud_fault
from sightline.geometry.given_arrays import Given, given_array
from sightline.geometry.mount import mount_doubt, pixel_doubt
from sightline.geometry.plain_arrays import without_masked
from sightline.geometry.user_warning import warn_user
from sightline.geometry.wrong_types import named_arguments
from sightline.structures.arrays import (
    cloud_columns,
    image_remedy,
    warn_of_cloud,
    warn_of_levels,
    warn_of_view,
)
from sightline.structures.mounting import warn_of_axes
from sightline.structures.sample import SENSOR_FIELDS, CameraLidarSample

# A camera without points in view: far above the scene, pointing up.
_FAR_ABOVE = torch.eye(4, dtype=torch.float64)
_FAR_ABOVE[2, 3] = -1e9
_NO_VIEW = Calibration(
    image_from_camera=torch.eye(4, dtype=torch.float64)[:3], camera_from_lidar=_FAR_ABOVE
)
_LARGEST = 1e6  # metres; larger values are too coarse in float32


@dataclass(frozen=True, kw_only=True, slots=True)
class CorruptedArrays:
    """Output of the faulty sensors, in memory of its own, with a record of the corruption."""

    image: UInt8[np.ndarray, "height width 3"] | None
    points: Float32[np.ndarray, "num_delivered 4"] | None
    record: Record
    camera_mask: Bool[np.ndarray, "height width"]
    """Pixels of the image that may have changed."""
    lidar_mask: Bool[np.ndarray, "height width"]
    """Pixels hit by the changed points of the sweep."""
    broken_points: Bool[np.ndarray, " num_points"] | None
    """Points of the sound sweep that are lost or changed; None if no sweep was corrupted."""
    point_sources: Int64[np.ndarray, " num_delivered"] | None
    """Row of each delivered point in the sound sweep; -1 if it has none."""


@named_arguments
def corrupt_arrays(
    kind: str,
    severity: int,
    *,
    image: Given | None = None,
    points: Given | None = None,
    image_from_camera: Given | None = None,
    camera_from_lidar: Given | None = None,
    image_size: Sequence[SupportsIndex] | None = None,
    depth: Given | None = None,
    seed: int = 0,
    name: str = "",
    lidar: SpinningLidar = HDL_64E,
) -> CorruptedArrays:
    """Corrupt an image and a sweep; the same arguments give the same result.

    Args:
        kind: One of `kinds.KINDS`, or several in their order, joined by `+`: camera_fog+lidar_fog.
        severity: From 1, slight, to 5.
        image: RGB, uint8, height x width x 3; an array or a tensor. None: no camera.
        points: N x 4: x forward, y left, z up [m] and reflectance in [0, 1]; in N x 3 the
            reflectances are 0, further columns are dropped (`point_sources` gives the rows). An
            array, a tensor or nested lists, as for the matrices. None: no LiDAR. The output is
            float32.
        image_from_camera: 3 x 4, pixels from metres of the camera (x right, y down, z forward):
            KITTI's P2; for an intrinsic matrix K, K with a column of zeros. None, as for the next
            argument, for kinds that need no calibration: then `lidar_mask` is meaningless.
        camera_from_lidar: 4 x 4, rigid.
        image_size: Height and width of the camera's image [px]; needed with a calibration but
            without an image.
        depth: Height x width, floating point: metres along the optical axis, 0 unknown; for weather
            in the camera. None: the sweep's depth is used.
        seed: Not negative.
        name: Frame name: each frame has random draws of its own, the same for all severities of a
            kind.
        lidar: Beams and range of the LiDAR; rings that are not of it are found in the sweep.

    Warns if sweep and calibration are unlikely to belong together.

    Raises:
        TypeError: The kind or the name is not a string, or the LiDAR is not a `SpinningLidar`.
        ValueError: There is no such kind or severity, an array is not as described, most points lie
            beyond 300 m, or the kind needs a calibration.
    """
    corruption = find_corruption(kind, severity, _lidar(lidar))
    seed = _seed(seed)
    name = plain_text("name", name)
    planes = None if image is None else _image(given_array("image", image))
    calibration = _calibration(image_from_camera, camera_from_lidar)
    if calibration is None:
        if needs_calibration(corruption):
            raise ValueError(
                f"{kind} needs a calibration; give image_from_camera and camera_from_lidar"
            )
        calibration = _NO_VIEW
        image_size = (1, 1) if planes is None and image_size is None else image_size
    size = _image_size(planes, image_size)
    sweep = None if points is None else _points(given_array("points", points))
    if sweep is not None and calibration is not _NO_VIEW:
        _warn_if_inconsistent(sweep, calibration, size)
    sample = CameraLidarSample(
        sample_id=name,
        calibration=calibration,
        image_size=size,
        image=planes,
        points=sweep,
        depth=None if depth is None else _depth(_depth_array(depth), size),
    )
    for sensor in corruption.sensors:
        if getattr(sample, SENSOR_FIELDS[sensor]) is None:
            field = SENSOR_FIELDS[sensor]
            raise ValueError(f"{kind} breaks the {sensor}, which has no {field} here; give {field}")
    return _arrays(corruption.corrupt(sample, fault_rng(sample, seed, corruption.kind)))


def _calibration(
    image_from_camera: Given | None, camera_from_lidar: Given | None
) -> Calibration | None:
    if image_from_camera is None and camera_from_lidar is None:
        return None
    if image_from_camera is None or camera_from_lidar is None:
        raise ValueError(
            "a calibration needs both image_from_camera and camera_from_lidar; give both or neither"
        )
    return Calibration(
        image_from_camera=_matrix("image_from_camera", image_from_camera, (3, 4)),
        camera_from_lidar=_matrix("camera_from_lidar", camera_from_lidar, (4, 4)),
    )


def _lidar(lidar: object) -> SpinningLidar:
    if not isinstance(lidar, SpinningLidar):
        expected = "a SpinningLidar; take HDL_64E of sightline.corruptions.sensor"
        raise wrong_type("lidar", lidar, expected)
    return lidar


def _seed(seed: object) -> int:
    if not isinstance(seed, bool | np.bool_):
        with suppress(TypeError):
            number = index(seed)  # type: ignore[arg-type]  # TypeError for anything else
            if number < 0:
                raise ValueError(f"seed must not be negative, got {number}")
            return number
    raise ValueError(f"seed is {short_repr(seed)}, expected a whole number of 0 or more; give one")


def _warn_if_inconsistent(
    sweep: Float32[torch.Tensor, "num_points 4"], calibration: Calibration, size: tuple[int, int]
) -> None:
    """Warn of a sweep that is unlikely to match the calibration, as `from_arrays` does."""
    doubt = mount_doubt(calibration.camera_from_lidar.numpy())
    pixels = pixel_doubt(calibration.image_from_camera.numpy())
    if pixels is not None:
        warn_user(f"image_from_camera {pixels}")
    if doubt is not None:
        warn_user(f"camera_from_lidar {doubt}")
    elif not warn_of_axes(sweep, calibration):
        warn_of_view(sweep, calibration, size, camera="image_from_camera")


def _depth_array(depth: Given) -> Shaped[np.ndarray, "..."]:
    """Convert a depth map to an array; masked values are unknown."""
    return given_array("depth", without_masked(depth, 0.0))


def _image_size(
    image: UInt8[torch.Tensor, "3 height width"] | None, given: Sequence[SupportsIndex] | None
) -> tuple[int, int]:
    size = None if given is None else plain_size("image_size", given)
    if image is None:
        if size is None:
            raise ValueError("image_size is missing; give (height, width) if there is no image")
        return size
    height, width = image.shape[1:]
    if size not in (None, (height, width)):
        raise ValueError(
            f"image is {height}x{width} (height x width), but image_size is "
            f"{'x'.join(map(str, size))}; omit image_size if an image is given"
        )
    return height, width


def _image(image: Shaped[np.ndarray, "..."]) -> UInt8[torch.Tensor, "3 height width"]:
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3 or not image.size:
        raise ValueError(
            f"image must be uint8, height x width x 3; got {_dtype_and_shape(image)}: "
            f"{image_remedy(image)}"
        )
    warn_of_levels(image)
    return torch.from_numpy(np.ascontiguousarray(image.transpose(2, 0, 1)))


def _points(points: Shaped[np.ndarray, "..."]) -> Float32[torch.Tensor, "num_points 4"]:
    if points.ndim != 2:  # the output refers to rows of the given sweep
        raise ValueError(
            f"points must be N x 3 or more, one row a point; got {_dtype_and_shape(points)}"
        )
    columns = cloud_columns(points)
    # In float64, because float16 cannot store the limit; NaN fails the comparison, too.
    is_plausible = (np.abs(columns) <= _LARGEST).all(axis=1)
    if not is_plausible.all():
        raise ValueError(
            f"points must be finite and at most {_LARGEST:g}; row "
            f"{int(np.flatnonzero(~is_plausible)[0])} is not; remove such points"
        )
    reflectances = columns[:, 3]
    # checks of the range only: here, no reflectance may be above 1
    fault = cloud_fault(columns, np.inf) if len(columns) and reflectances.min() >= 0 else None
    if fault is not None:
        raise ValueError(f"points: {fault[0]}; {fault[1]}")
    if len(columns) and not 0 <= reflectances.min() <= reflectances.max() <= 1:
        raise ValueError(
            f"reflectances (column 3 of points) must be from 0 to 1, got {reflectances.min():g} to "
            f"{reflectances.max():g}; divide by the sensor's full scale, for example 255"
        )
    warn_of_cloud(columns, 1.0)
    return torch.from_numpy(columns.astype(np.float32))


def _depth(
    depth: Shaped[np.ndarray, "..."], size: tuple[int, int]
) -> Float32[torch.Tensor, "height width"]:
    if not np.issubdtype(depth.dtype, np.floating) or depth.shape != size:
        raise ValueError(
            f"depth must be floating point, height x width as the image, {size[0]} x {size[1]}; "
            f"got {_dtype_and_shape(depth)}"
        )
    if not (depth >= 0).all():
        raise ValueError("depth must not be negative or NaN: metres, 0 = unknown")
    if not np.isfinite(depth).all():
        raise ValueError("depth must be finite: metres, 0 = unknown")
    doubt = depth_range_doubt(depth)
    if doubt is not None:
        warn_user(f"depth {doubt}: give metres, not values of a PNG")
    return torch.from_numpy(depth.astype(np.float32))


def _matrix(
    name: str, given: Given, shape: tuple[int, int]
) -> Float64[torch.Tensor, "rows columns"]:
    matrix = given_array(name, given)
    if matrix.shape != shape or matrix.dtype.kind not in "fiu":
        raise ValueError(
            f"{name} must be {shape[0]} x {shape[1]} numbers, got {_dtype_and_shape(matrix)}"
        )
    return torch.from_numpy(matrix.astype(np.float64))


def _dtype_and_shape(array: Shaped[np.ndarray, "..."]) -> str:
    return f"{array.dtype} of shape {' x '.join(map(str, array.shape)) or '()'}"


def _arrays(corrupted: Corrupted) -> CorruptedArrays:
    sample = corrupted.sample
    image, points = sample.image, sample.points
    broken, sources = corrupted.broken_points, corrupted.point_sources
    return CorruptedArrays(
        # Copied, because unchanged data may be the caller's own memory.
        image=None if image is None else image.numpy().transpose(1, 2, 0).copy(),
        points=None if points is None else points.numpy().copy(),
        record=corrupted.record,
        camera_mask=corrupted.camera_mask.numpy(),
        lidar_mask=corrupted.lidar_mask.numpy(),
        broken_points=None if broken is None else broken.numpy(),
        point_sources=None if sources is None else sources.numpy(),
    )

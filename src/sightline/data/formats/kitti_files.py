"""Readers and writers of KITTI's files with tensors and types of the project.

Any bytes give a value or a FileError with the file's name. Files are written atomically. The
readers without PyTorch are in `velodyne`, `kitti_calibration`, `image_file`, `map_png`.
"""

from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float32, UInt8
from numpy.typing import ArrayLike
from torch import Tensor

from sightline.data.formats.image_file import read_rgb, write_rgb
from sightline.data.formats.kitti_calibration import (
    CalibrationMatrices,
    object_calibration_text,
    raw_calibration_texts,
    read_object_matrices,
    read_raw_matrices,
)
from sightline.data.formats.map_png import read_depth_png
from sightline.data.formats.velodyne import read_sweep, write_sweep
from sightline.files.atomic import atomic_write_text
from sightline.files.plain_text import REMEDY
from sightline.files.problem import FileError
from sightline.geometry.calibration import Calibration
from sightline.geometry.wrong_types import named_arguments
from sightline.structures.arrays import image_remedy


@named_arguments
def read_points(
    path: Path | str, *, drop_non_finite: bool = False
) -> Float32[Tensor, "num_points 4"]:
    """Read a sweep: x, y, z [m] in the LiDAR frame, reflectance [0, 1]; see `read_sweep`."""
    return torch.from_numpy(read_sweep(path, drop_non_finite=drop_non_finite))


@named_arguments
def write_points(path: Path | str, points: ArrayLike) -> None:
    """Write a sweep for `read_points`; see `write_sweep`."""
    write_sweep(path, points)


@named_arguments
def read_image(path: Path | str) -> UInt8[Tensor, "3 height width"]:
    """Read a PNG or JPEG picture as RGB, channels first; see `read_rgb`."""
    return torch.from_numpy(np.ascontiguousarray(read_rgb(path).transpose(2, 0, 1)))


@named_arguments
def write_image(path: Path | str, image: UInt8[Tensor, "3 height width"]) -> None:
    """Write an RGB picture as PNG or JPEG, by the suffix; see `write_rgb`.

    Raises:
        ValueError: The picture has another type or shape; or as for `write_rgb`.
    """
    planes = image.numpy(force=True)
    if planes.dtype != np.uint8 or planes.ndim != 3 or len(planes) != 3:
        raise ValueError(
            f"{path} cannot be written: the picture is {planes.dtype} of shape {planes.shape}, "
            f"expected uint8 of 3, height, width; {image_remedy(planes, is_tensor=True)}"
        )
    write_rgb(path, planes.transpose(1, 2, 0))


@named_arguments
def read_depth(path: Path | str) -> Float32[Tensor, "height width"]:
    """Read a depth map [m], 0 = no value, from a 16-bit PNG; see `read_depth_png`."""
    return torch.from_numpy(read_depth_png(path))


@named_arguments
def read_object_calibration(path: Path | str) -> Calibration:
    """Read the object benchmark's calibration of camera 2; see `read_object_matrices`."""
    return calibration_of(read_object_matrices(path), path)


@named_arguments
def write_object_calibration(path: Path | str, calibration: Calibration) -> None:
    """Write a calibration in the object benchmark's format; see `object_calibration_text`."""
    atomic_write_text(path, object_calibration_text(_matrices(calibration)))


@named_arguments
def read_raw_calibration(folder: Path | str) -> Calibration:
    """Read camera 2's calibration from a raw recording's folder; see `read_raw_matrices`."""
    return calibration_of(read_raw_matrices(folder), folder)


@named_arguments
def write_raw_calibration(folder: Path | str, calibration: Calibration) -> None:
    """Write the two files that `read_raw_calibration` reads; see `raw_calibration_texts`."""
    cameras, lidar = raw_calibration_texts(_matrices(calibration))
    atomic_write_text(Path(folder, "calib_cam_to_cam.txt"), cameras)
    atomic_write_text(Path(folder, "calib_velo_to_cam.txt"), lidar)


@named_arguments
def calibration_of(matrices: CalibrationMatrices, source: Path | str) -> Calibration:
    """Convert the matrices of a file.

    Raises:
        FileError: They are no calibration; names `source`.
    """
    try:
        return Calibration(
            image_from_camera=torch.from_numpy(matrices.image_from_camera),
            camera_from_lidar=torch.from_numpy(matrices.camera_from_lidar),
        )
    except ValueError as error:
        raise FileError(source, str(error), REMEDY) from error


def _matrices(calibration: Calibration) -> CalibrationMatrices:
    if calibration.image_from_camera.ndim != 2:
        raise ValueError(
            f"a calibration file holds one calibration, got a batch of shape "
            f"{tuple(calibration.image_from_camera.shape[:-2])}; write each to its own file"
        )
    return CalibrationMatrices(
        image_from_camera=calibration.image_from_camera.numpy(force=True),
        camera_from_lidar=calibration.camera_from_lidar.numpy(force=True),
    )

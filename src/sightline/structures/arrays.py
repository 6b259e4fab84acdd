"""Pictures and point clouds as users have them, made into what a sample holds."""

import reprlib
import warnings
from collections.abc import Sequence
from contextlib import suppress
from operator import index
from typing import SupportsFloat, SupportsIndex

import numpy as np
import torch
from jaxtyping import Float32, Float64, UInt8
from torch import Tensor

from sightline.geometry.calibration import Calibration
from sightline.geometry.cloud_checks import (
    cloud_fault,
    echoes,
    reflectances,
    rows_of,
    warn_of_columns,
    warn_of_losses,
    warn_of_scale,
)
from sightline.geometry.mount import LEAST_SHARE_IN_IMAGE, mount_doubt, resolution_doubt
from sightline.geometry.projection import project_points


def plain_number(name: str, value: SupportsFloat) -> float:
    """A number of any type, of NumPy's or a tensor as well.

    Raises:
        ValueError: It is none.
    """
    if not isinstance(value, str | bytes):
        # RuntimeError: PyTorch's of several numbers.
        with suppress(TypeError, ValueError, OverflowError, RuntimeError):
            return float(value)
    raise ValueError(f"{name} is {_said(value)}, expected a number; give one")


def plain_size(image_size: Sequence[SupportsIndex]) -> tuple[int, int]:
    """Height and width [px] of any whole numbers.

    Raises:
        ValueError: They are not two, not whole or not positive.
    """
    with suppress(TypeError):
        size = tuple(index(side) for side in image_size)
        if len(size) == 2 and min(size) > 0:
            return size[0], size[1]
    raise ValueError(
        f"image_size is {_said(image_size)}, expected (height, width), each a whole number of at "
        "least 1; give pixels"
    )


def _said(value: object) -> str:
    """A wrong argument, short and in one line."""
    return " ".join(reprlib.repr(value).split())


def image_planes(image: np.ndarray | Tensor) -> UInt8[Tensor, "3 height width"]:
    """A picture as RGB, channels first.

    Args:
        image: 8 bits, colour or grey; an array of height, width (, 3 or 1), or a tensor of
            3, height, width.

    Raises:
        ValueError: It is something else.
    """
    plain = image if isinstance(image, Tensor) else np.array(image, order="C")
    if isinstance(plain, np.ndarray) and plain.dtype == np.uint8 and plain.ndim in (2, 3):
        channels_last = plain if plain.ndim == 3 else plain[..., None]
        planes = torch.from_numpy(channels_last).permute(2, 0, 1)
        planes = planes.expand(3, -1, -1) if len(planes) == 1 else planes
    else:
        planes = torch.as_tensor(plain) if isinstance(plain, Tensor) else torch.empty(0)
    if planes.dtype != torch.uint8 or planes.ndim != 3 or len(planes) != 3 or not planes.numel():
        raise ValueError(
            f"the image is {plain.dtype} of shape {tuple(plain.shape)}, expected uint8, an array "
            "of height, width, 3 or a tensor of 3, height, width; convert it to RGB of 8 bits"
        )
    return planes.cpu().contiguous()


def sweep_points(
    points: np.ndarray | Tensor, max_intensity: SupportsFloat = 1.0
) -> Float32[Tensor, "num_points 4"]:
    """A cloud as x, y, z [m] and reflectance in [0, 1].

    Left out are rows that no echo made: x, y, z are not finite, or all zero; an intensity that is
    not finite becomes 0. A warning counts such intensities, and rows that are left out where they
    are most of the cloud. What is brighter than max_intensity, as retroreflectors are, gets 1; one
    that all intensities stay far below is warned of.

    Args:
        points: x, y, z and intensity first; a warning tells of a lacking intensity, for which 0 is
            taken, and of further columns, which are left out. Rows, or rows of rows.
        max_intensity: What stands for a reflectance of 1.

    Raises:
        ValueError: There are fewer than three columns, most points lie beyond 300 m, an intensity
            is negative, more than one in a hundred lies above max_intensity, or they are ring
            numbers.
    """
    columns = cloud_columns(points)
    max_intensity = plain_number("max_intensity", max_intensity)
    if not 0 < max_intensity < np.inf:
        raise ValueError(f"max_intensity must be positive, got {max_intensity}; often it is 255")
    warn_of_losses(columns, "the points")
    columns = echoes(columns)
    fault = cloud_fault(columns, max_intensity)
    if fault is not None:
        problem, remedy = fault
        raise ValueError(f"the cloud has {problem}; {remedy}")
    warn_of_scale(columns[:, 3], max_intensity)
    columns[:, 3] = reflectances(columns[:, 3], max_intensity)
    return torch.from_numpy(columns.astype(np.float32))


def cloud_columns(points: np.ndarray | Tensor) -> Float64[np.ndarray, "num_points 4"]:
    """Take x, y, z and intensity (else 0) from rows of three columns or more, as they are.

    A warning tells of a lacking intensity and of further columns.

    Raises:
        ValueError: There are no such rows.
    """
    plain = points.detach().cpu().numpy() if isinstance(points, Tensor) else np.asarray(points)
    rows = rows_of(plain)
    if rows is None:
        raise ValueError(
            f"the points are {plain.dtype} of shape {plain.shape}, expected numbers in rows of x, "
            "y, z [m] and perhaps intensity; give one row a point"
        )
    warn_of_columns(rows.shape[1], len(rows))
    columns = rows[:, :4].astype(np.float64)
    return np.pad(columns, ((0, 0), (0, 4 - columns.shape[1])))


def warn_of_view(
    points: Float32[Tensor, "num_points 4"], calibration: Calibration, image_size: tuple[int, int]
) -> None:
    """Warns, with the likely cause, where hardly a point falls into the image, or it is scaled."""
    scale = resolution_doubt(calibration.image_from_camera.numpy(), image_size)
    if scale is not None:
        warnings.warn(f"camera_matrix {scale}", stacklevel=3)
    share = share_in_image(points, calibration, image_size)
    if len(points) and share < LEAST_SHARE_IN_IMAGE:
        doubt = mount_doubt(calibration.camera_from_lidar.numpy())
        cause = (
            f"camera_from_lidar {doubt}"
            if doubt is not None
            else "check camera_matrix against the image's size, and that the sweep is of this LiDAR"
        )
        warnings.warn(
            f"{100 * share:.2g} % of the {len(points)} points fall into the image of "
            f"{image_size[0]}x{image_size[1]} (height x width): {cause}",
            stacklevel=3,
        )


def share_in_image(
    points: Float32[Tensor, "num_points 4"], calibration: Calibration, image_size: tuple[int, int]
) -> float:
    """Which share of a sweep's points the image shows, 0 to 1; 0 of an empty sweep."""
    shown = project_points(points[:, :3], calibration).in_image(image_size)
    return float(shown.float().mean()) if len(points) else 0.0

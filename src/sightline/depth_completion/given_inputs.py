"""Inputs of depth completion as users give them: checked, and converted to tensors."""

from typing import Final

import numpy as np
import torch
from jaxtyping import Float, Float32, Real
from torch import Tensor

from sightline.depth_completion.sparse_map import check_sparse_depth
from sightline.geometry.cloud_checks import as_point_rows, cloud_fault
from sightline.geometry.echoes import USUAL_LOSS, warn_of_losses
from sightline.geometry.given_arrays import given_array
from sightline.geometry.mount import MAX_RANGE_M
from sightline.geometry.plain_arrays import without_masked
from sightline.geometry.projection import sparse_depth_map
from sightline.geometry.user_warning import warn_user
from sightline.structures.arrays import image_remedy, warn_of_levels
from sightline.structures.sample import CameraLidarSample, check_points

COORDINATES: Final = 3
"""Number of a point's coordinates."""

# User input is checked on entry, so that the error contains the remedy.
SparseMap = Real[Tensor, "*size"] | Real[np.ndarray, "*size"]
"""Sparse depth map of height x width; metres along the optical axis, 0 = no measurement."""
Points = Real[Tensor, "*shape"] | Real[np.ndarray, "*shape"]
"""Points of number x fields: x, y, z first [m], LiDAR frame."""
RGBImage = Real[Tensor, "*channels_and_size"] | Real[np.ndarray, "*size_and_channels"]
"""RGB image of 8 bits; a tensor of 3, height, width or an array of height, width, 3."""


def sparse_depth_of(
    sample: CameraLidarSample, *, needs_sweep: bool = False
) -> Float32[Tensor, "height width"]:
    """Project a sample's sweep into its image; without a sweep, an empty map if that will do.

    Raises:
        ValueError: The sweep is missing, or has points that `check_points` refuses.
    """
    if sample.points is None:
        if sample.image is not None and not needs_sweep:
            return torch.zeros(sample.image_size)
        wanted = "LiDAR points" if needs_sweep else "LiDAR points, or images to guess it from"
        raise ValueError(
            f"sample {sample.sample_id} has no sweep, so there is no depth to complete; give data "
            f"with {wanted}"
        )
    check_points(sample)
    return sparse_depth_map(sample.points, sample.calibration, sample.image_size)


def sparse_plane(sparse_depth_m: SparseMap) -> Float32[Tensor, "height width"]:
    """Convert a sparse map; masked pixels have no measurement.

    Raises:
        ValueError: It is no map of valid depths.
    """
    sparse = _to_tensor("the sparse depth map", without_masked(sparse_depth_m, 0.0)).float()
    if sparse.ndim != 2:
        raise ValueError(
            f"the sparse depth map has the shape {tuple(sparse.shape)}, expected height and width; "
            "complete one map at a time"
        )
    check_sparse_depth(sparse.numpy())
    depths_m = sparse.numpy()[sparse.numpy() > 0]
    if len(depths_m) and np.median(depths_m) > MAX_RANGE_M:
        warn_user(
            f"half of the sparse depth map's values are above {MAX_RANGE_M:g} m, beyond every "
            "LiDAR: give metres, not values of a PNG or millimetres",
        )
    return sparse


def checked_points(points: Points) -> Float[Tensor, "num_points fields"]:
    """Convert points, and warn of those that are not finite.

    Raises:
        ValueError: They are no rows of coordinates, or are no cloud of a LiDAR.
    """
    tensor = _to_tensor("the points", without_masked(points))
    if tensor.ndim != 2 or as_point_rows(tensor.numpy()) is None:
        raise ValueError(
            f"the points have the shape {tuple(tensor.shape)}, expected one row per point that "
            "begins with x, y, z; give the sweep as an array of points by fields"
        )
    positions = np.pad(tensor[:, :COORDINATES].double().numpy(), ((0, 0), (0, 1)))
    is_masked = isinstance(points, np.ma.MaskedArray)  # those were chosen by the user
    warn_of_losses(positions, "the points", usual_share=USUAL_LOSS if is_masked else 0.0)
    fault = cloud_fault(positions[np.isfinite(positions).all(axis=1)], 1.0)
    if fault is not None:
        raise ValueError(f"the cloud has {fault[0]}; {fault[1]}")
    return tensor if tensor.is_floating_point() else tensor.float()


def _to_tensor(name: str, values: object) -> Tensor:
    """Convert to a CPU tensor; arrays are copied, as PyTorch accepts no negative strides."""
    array = given_array(name, values)
    if array.dtype.kind not in "fiu":
        raise ValueError(
            f"{name} is {array.dtype} of shape {array.shape}, expected an array of numbers; give "
            "metres, or an image of 8 bits"
        )
    return torch.from_numpy(np.array(array, dtype=array.dtype.newbyteorder("="), order="C"))


def rgb_planes(image: RGBImage | None, size: tuple[int, int]) -> Float32[Tensor, "3 height width"]:
    """Convert the image to [0, 1]; black if there is none."""
    if image is None:
        return torch.zeros(3, *size)
    is_channels_last = isinstance(image, np.ndarray)
    planes = _to_tensor("the image", image)
    expected = (*size, 3) if is_channels_last else (3, *size)
    if planes.dtype != torch.uint8 or tuple(planes.shape) != expected:
        channels = planes.shape[-1 if is_channels_last else 0] if planes.ndim == 3 else 0
        remedy = (
            "give it in that size"
            if planes.dtype == torch.uint8 and channels == 3
            else image_remedy(planes.numpy(), is_tensor=not is_channels_last)
        )
        raise ValueError(
            f"the image is {planes.dtype} of shape {tuple(planes.shape)}, expected torch.uint8 of "
            f"shape {expected} like the sparse depth map; {remedy}"
        )
    if is_channels_last:
        planes = planes.permute(2, 0, 1)
    return torch.from_numpy(planes.numpy(force=True) / np.float32(255))


def given_planes(
    image: RGBImage | None, size: tuple[int, int]
) -> Float32[Tensor, "3 height width"]:
    """Convert a user's image as `rgb_planes` does, and warn of levels from 0 to 3 alone."""
    planes = rgb_planes(image, size)
    if image is not None:
        warn_of_levels((planes * 255).round().to(torch.uint8).numpy())
    return planes

"""Postprocessing of a network's output to a depth map with a validity mask."""

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32
from torch import Tensor

from sightline.depth_completion.config import PlaneSmoothing
from sightline.depth_completion.plane_smoothing import smooth_planes
from sightline.structures.predictions import DepthMap

NEAREST_M = 0.5
"""Smallest depth of a network: 0 means "no value", and an HDL-64E measures from 0.9 m."""
FARTHEST_M = 120.0
"""Largest depth of a network: the range of an HDL-64E. KITTI's ground truth ends before 90 m."""
TRUSTED_SHARE = 0.2
"""Largest expected error of a valid depth, as a share of the depth."""


def to_depth_map(
    depth_m: Float[Tensor, "height width"],
    uncertainty_m: Float[Tensor, "height width"] | None,
    *,
    is_supported: Bool[Tensor, "height width"],
    smoothing: PlaneSmoothing | None = None,
) -> DepthMap:
    """Convert a network's output for one frame to a depth map on the CPU.

    Depths are clamped to [`NEAREST_M`, `FARTHEST_M`]: outside, a network extrapolates. Non-finite
    depths become "no value". A pixel is valid if measurements support it and its expected error,
    if the network estimates one, is below `TRUSTED_SHARE`. The estimate alone is not enough: in
    the sky no network was trained on a truth.

    Args:
        depth_m: Metres along the optical axis, not clamped.
        uncertainty_m: Expected absolute error.
        is_supported: Mask of the pixels among measurements.
        smoothing: Smoothing of the planes; None: no smoothing.
    """
    predicted, supported = _to_array(depth_m), is_supported.numpy(force=True)
    has_value = np.isfinite(predicted)
    depth = np.where(has_value, predicted.clip(NEAREST_M, FARTHEST_M), np.float32(0))
    if smoothing is not None:
        smooth = smooth_planes(depth, windows_px=smoothing.windows_px, noise_m=smoothing.noise_m)
        depth = np.where(has_value, smooth.clip(NEAREST_M, FARTHEST_M), np.float32(0))
    if uncertainty_m is None:
        return DepthMap(
            depth_m=torch.from_numpy(depth), valid=torch.from_numpy(has_value & supported)
        )
    uncertainty = _to_array(uncertainty_m)
    is_estimate = has_value & (uncertainty >= 0)  # NaN compares false too
    uncertainty = np.where(is_estimate, uncertainty, np.float32(np.inf))
    is_trusted = uncertainty < np.float32(TRUSTED_SHARE) * depth
    return DepthMap(
        depth_m=torch.from_numpy(depth),
        valid=torch.from_numpy(supported & is_trusted),
        uncertainty_m=torch.from_numpy(uncertainty),
    )


def only_valid(depth_map: DepthMap) -> DepthMap:
    """Keep only trusted values: other pixels get depth 0 and an infinite error."""
    is_kept, uncertainty_m = depth_map.valid, depth_map.uncertainty_m
    return DepthMap(
        depth_m=torch.where(is_kept, depth_map.depth_m, 0.0),
        valid=is_kept & (depth_map.depth_m > 0),
        uncertainty_m=(
            None if uncertainty_m is None else torch.where(is_kept, uncertainty_m, torch.inf)
        ),
    )


def _to_array(plane: Float[Tensor, "height width"]) -> Float32[np.ndarray, "height width"]:
    """Convert to numpy, whose threads do not keep waiting as PyTorch's do: see `DepthPredictor`."""
    array: Float32[np.ndarray, "height width"] = plane.float().numpy(force=True)
    return array

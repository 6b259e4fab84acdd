"""From what a network puts out to a depth map that says where it may be believed."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from sightline.structures.predictions import DepthMap

NEAREST_M = 0.5
"""A network's depth never comes nearer: 0 means "no value", and an HDL-64E measures from 0.9 m."""
FARTHEST_M = 120.0
"""Nor farther: the range of an HDL-64E. KITTI's ground truth ends before 90 m."""
TRUSTED_SHARE = 0.2
"""An expected error of more than this share of the depth makes a value a guess."""


def to_depth_map(
    depth_m: Float[Tensor, "height width"],
    uncertainty_m: Float[Tensor, "height width"] | None,
    *,
    is_supported: Bool[Tensor, "height width"],
) -> DepthMap:
    """A network's output for one frame as a depth map on the CPU.

    Depths are clamped to between `NEAREST_M` and `FARTHEST_M`: outside, a network extrapolates.
    One that is not finite is no value. Valid is what the measurements support and, where the
    network estimates its error, is expected to be off by less than `TRUSTED_SHARE`. Both are asked
    for: the estimate alone says nothing about the sky, where no network ever saw a truth.

    Args:
        depth_m: Metres along the optical axis, not clamped.
        uncertainty_m: Expected absolute error.
        is_supported: Pixels that lie among measurements.
    """
    depth, is_supported = depth_m.detach().float().cpu(), is_supported.cpu()
    has_value = depth.isfinite()
    depth = torch.where(has_value, depth.clamp(NEAREST_M, FARTHEST_M), 0.0)
    if uncertainty_m is None:
        return DepthMap(depth_m=depth, valid=has_value & is_supported)
    uncertainty = uncertainty_m.detach().float().cpu()
    is_estimate = has_value & (uncertainty >= 0)  # NaN, too, compares false
    uncertainty = torch.where(is_estimate, uncertainty, torch.inf)
    is_trusted = uncertainty < TRUSTED_SHARE * depth
    return DepthMap(depth_m=depth, valid=is_supported & is_trusted, uncertainty_m=uncertainty)

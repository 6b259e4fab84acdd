"""Nearest and farthest measurements around each pixel, as inputs of a network."""

from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

NUM_PLANES = 7
_MIN_DEPTH_M, _MAX_DEPTH_M = 1.0, 120.0  # depths are clamped before their logarithm
_MIDDLE, _HALF_SPAN = 3.0, 2.0  # normalisation of those logarithms
_MAX_LOG_RATIO = 2.0
_MAX_INVERSE_DEPTH = 9.0  # 1/m; larger than that of any measurement


class Surroundings(NamedTuple):
    """Measurements in the square window around each pixel."""

    nearest_m: Float[Tensor, "batch 1 height width"]
    """Nearest depth among the measurements and the pixel's completed depth."""
    farthest_m: Float[Tensor, "batch 1 height width"]
    """Farthest depth among the measurements and the pixel's completed depth."""
    planes: Float[Tensor, "batch 7 height width"]
    """Seven input planes: the completion's logarithm, scaled to about -1 to 1; the logarithms of
    nearest, farthest and measured depth minus the completion's, 0 where there is none; masks of
    pixels with a measurement in the window, with their own, and without any in their column from
    the top down to their row."""


def find_surroundings(
    sparse_depth_m: Float[Tensor, "batch 1 height width"],
    filled_depth_m: Float[Tensor, "batch 1 height width"],
    reach_px: int,
) -> Surroundings:
    """Find the nearest and farthest measurement in the window around each pixel.

    Args:
        sparse_depth_m: Measurements; 0 = none.
        filled_depth_m: Completion of the measurements, positive.
        reach_px: Reach of the window to each side.
    """
    is_measured = sparse_depth_m > 0
    inverse = torch.where(is_measured, 1 / sparse_depth_m.clamp(min=1 / _MAX_INVERSE_DEPTH), 0.0)
    near = _window_maximum(inverse, reach_px)
    far = -_window_maximum(torch.where(is_measured, -inverse, -_MAX_INVERSE_DEPTH), reach_px)
    has_any = near > 0
    nearest_m = torch.where(has_any, 1 / near.clamp(min=1 / _MAX_DEPTH_M), filled_depth_m)
    farthest_m = torch.where(has_any, 1 / far.clamp(min=1 / _MAX_DEPTH_M), filled_depth_m)
    log_filled = _log(filled_depth_m)

    def ratio(depth_m: Tensor) -> Tensor:
        return (_log(depth_m) - log_filled).clamp(-_MAX_LOG_RATIO, _MAX_LOG_RATIO)

    is_above = torch.cumsum(is_measured.to(log_filled.dtype), dim=2) == 0
    planes = (
        (log_filled - _MIDDLE) / _HALF_SPAN,
        ratio(nearest_m),
        ratio(farthest_m),
        torch.where(is_measured, ratio(sparse_depth_m), 0.0),
        has_any.to(log_filled.dtype),
        is_measured.to(log_filled.dtype),
        is_above.to(log_filled.dtype),
    )
    return Surroundings(
        torch.minimum(nearest_m, filled_depth_m),
        torch.maximum(farthest_m, filled_depth_m),
        torch.cat(planes, dim=1),
    )


def _window_maximum(plane: Tensor, reach_px: int) -> Tensor:
    side = 2 * reach_px + 1
    columns = F.max_pool2d(plane, (side, 1), stride=1, padding=(reach_px, 0))
    return F.max_pool2d(columns, (1, side), stride=1, padding=(0, reach_px))


def _log(depth_m: Tensor) -> Tensor:
    return depth_m.clamp(_MIN_DEPTH_M, _MAX_DEPTH_M).log()

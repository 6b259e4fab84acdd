"""Which parts of the sensors' images a fault has taken away: what gates are taught."""

from typing import Final

import torch
import torch.nn.functional as F
from jaxtyping import Float, Float32
from torch import Tensor

CELL_PX: Final = 8
"""Side of the cells that health is told for: the finest maps' stride."""


def camera_health(
    before: Float32[Tensor, "3 height width"], after: Float32[Tensor, "3 height width"]
) -> Float32[Tensor, "1 rows columns"]:
    """Share of each cell's pixels that have not become black; NaN where all were black before."""
    return _kept_share(_is_given(before), _is_given(after))


def lidar_health(
    before: Float32[Tensor, "3 height width"], after: Float32[Tensor, "3 height width"]
) -> Float32[Tensor, "1 rows columns"]:
    """Share of each cell's pixels with a point that still have one; NaN where there was none.

    Where the whole sweep is gone, that is known of the cells without points too: 0.
    """
    given, kept = _is_given(before), _is_given(after)
    share = _kept_share(given, kept)
    return torch.zeros_like(share) if given.any() and not kept.any() else share


def pooled_health(
    health: Float[Tensor, "batch 1 rows columns"], rows: int, columns: int
) -> Float[Tensor, "batch 1 new_rows new_columns"]:
    """Health at a coarser map: the mean of what is known, NaN where nothing is."""
    is_known = (~health.isnan()).to(health.dtype)
    size = (rows, columns)
    share = F.adaptive_avg_pool2d(health.nan_to_num(), size)
    known = F.adaptive_avg_pool2d(is_known, size)
    return torch.where(known > 0, share / known.clamp(min=1e-6), torch.nan)


def _is_given(image: Float32[Tensor, "3 height width"]) -> Float32[Tensor, "1 height width"]:
    return (image.amax(dim=0, keepdim=True) > 0).float()


def _kept_share(
    given: Float32[Tensor, "1 height width"], kept: Float32[Tensor, "1 height width"]
) -> Float32[Tensor, "1 rows columns"]:
    before, after = (F.avg_pool2d(each, CELL_PX, ceil_mode=True) for each in (given, given * kept))
    return torch.where(before > 0, after / before.clamp(min=1e-6), torch.nan)

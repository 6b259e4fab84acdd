"""Which parts of the sensors' images are left: what gates are taught."""

from typing import Final

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Float32
from torch import Tensor

from sightline.detection2d.placement import padded

CELL_PX: Final = 8
"""Side of the cells that health is told for: the finest maps' stride."""


def health(
    broken: Bool[Tensor, "height width"], size: tuple[int, int], *, nothing_left: bool
) -> Float32[Tensor, "1 rows columns"]:
    """Share of each cell's pixels within the image that a sensor still delivers.

    NaN, which is unknown, beyond the image, and where all of a cell is broken but not gone: how
    much is left of it, a gate must find out by itself.

    Args:
        broken: Where the sensor's image is.
        size: Height, width [px] that the image is padded to.
        nothing_left: Whether nothing of the scene is left where it is broken.
    """
    is_sound = ~broken
    is_known = torch.ones_like(broken) if nothing_left else is_sound
    sound, known = (
        F.avg_pool2d(padded(each[None].float(), size), CELL_PX, ceil_mode=True)
        for each in (is_sound, is_known)
    )
    return torch.where(known > 0, sound / known.clamp(min=1e-6), torch.nan)


def known_by_points(
    of_cells: Float32[Tensor, "1 rows columns"], lidar: Float32[Tensor, "3 height width"]
) -> Float32[Tensor, "1 rows columns"]:
    """Health of a LiDAR, unknown where a cell has no point: nothing tells it from one that is gone.

    Args:
        of_cells: Health.
        lidar: The sound LiDAR's image.
    """
    has_point = F.max_pool2d((lidar > 0).float(), CELL_PX, ceil_mode=True).amax(0, keepdim=True)
    return of_cells.where(has_point > 0, torch.nan)


def pooled_health(
    health: Float[Tensor, "batch 1 rows columns"], rows: int, columns: int
) -> Float[Tensor, "batch 1 new_rows new_columns"]:
    """Health at a coarser map: the mean of what is known, NaN where nothing is."""
    is_known = (~health.isnan()).to(health.dtype)
    size = (rows, columns)
    share = F.adaptive_avg_pool2d(health.nan_to_num(), size)
    known = F.adaptive_avg_pool2d(is_known, size)
    return torch.where(known > 0, share / known.clamp(min=1e-6), torch.nan)

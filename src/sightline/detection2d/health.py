"""Health maps: the working parts of the sensors' images, as targets of gates."""

from typing import Final

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Float32
from torch import Tensor

from sightline.detection2d.placement import padded

CELL_PX: Final = 8
"""Side of the health map's cells: the stride of the finest maps."""


def health(
    broken: Bool[Tensor, "height width"], size: tuple[int, int], *, nothing_left: bool
) -> Float32[Tensor, "1 rows columns"]:
    """Share of each cell's pixels within the image that a sensor still delivers.

    The share is NaN (unknown) beyond the image, and in cells that are fully broken but not gone:
    the gate has to learn by itself how much is left.

    Args:
        broken: Mask of the broken pixels of the sensor's image.
        size: Height, width [px] of the padded image.
        nothing_left: Whether broken pixels contain nothing of the scene.
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
    """Set a LiDAR's health to unknown in cells without points, which look the same if it fails.

    Args:
        of_cells: Health.
        lidar: The intact LiDAR's image.
    """
    has_point = F.max_pool2d((lidar > 0).float(), CELL_PX, ceil_mode=True).amax(0, keepdim=True)
    return of_cells.where(has_point > 0, torch.nan)


def pooled_health(
    health: Float[Tensor, "batch 1 rows columns"], rows: int, columns: int
) -> Float[Tensor, "batch 1 new_rows new_columns"]:
    """Pool health to a coarser map: the mean of known cells, NaN if there are none."""
    is_known = (~health.isnan()).to(health.dtype)
    size = (rows, columns)
    share = F.adaptive_avg_pool2d(health.nan_to_num(), size)
    known = F.adaptive_avg_pool2d(is_known, size)
    return torch.where(known > 0, share / known.clamp(min=1e-6), torch.nan)

"""Bird's-eye-view map of pillars from points: the compact first stage's input.

The features are plain statistics, computed before the network and not by it. So the exported graph
consists of convolutions alone, has one shape for any number of points, and needs no scatter.
"""

import torch
from jaxtyping import Bool, Float, Float32, Float64, Int64
from torch import Tensor

from sightline.detection3d.pillar_config import PillarGridConfig

PILLAR_COUNT_SCALE = 0.5  # factor on log(1 + number of points)
_ASIDE_AFTER_SLICES = 5  # channel of the mean y offset, counted from the point count
GROUND_SHIFT_M = 1.0  # heights are relative to the middle of road users, 1 m below the sensor


def pillar_features(
    points: Float[Tensor, "num_points fields"], grid: PillarGridConfig
) -> Float32[Tensor, "channels rows columns"]:
    """Compute the features of each pillar, zeros for empty ones, from any number of points.

    Channels: for each height, how close a point comes to it (1 at it, falling to 0 at the next
    heights); half the logarithm of 1 + the number of points; mean, highest and lowest z [m] + 1;
    the mean offset along x and y from the pillar's middle (-1 to 1 at its borders); and the mean
    reflectance, if requested. After Lang et al. 2019 (PointPillars), with heights kept apart and
    without layers before the scatter.

    Pillars and grid contain their lower borders but not their upper ones; in z, the grid contains
    both. Computed in float64: the order of the points does not matter beyond its rounding, and on a
    CPU the same points give the same bits. No gradient. The memory format is channels last.

    Args:
        points: x, y, z [m], LiDAR frame; reflectance as the fourth field, if requested.
        grid: The pillars.
    """
    values = points.detach().double()
    place = torch.stack(
        ((values[:, 0] - grid.x_m[0]) / grid.cell_m, (values[:, 1] - grid.y_m[0]) / grid.cell_m), 1
    )
    is_within = _within(place, values[:, 2], grid)
    place, values = place[is_within], values[is_within]
    row, column = place.long().unbind(dim=1)
    pillar = row * grid.columns + column
    z = values[:, 2]
    number = grid.rows * grid.columns
    count = torch.bincount(pillar, minlength=number).double()
    means = [z, *(2 * (place - place.floor()) - 1).unbind(dim=1)]
    if grid.reflectance:
        means.append(values[:, 3])
    summed = values.new_zeros(number, len(means)).index_add_(0, pillar, torch.stack(means, dim=1))
    mean = summed / count.clamp(min=1)[:, None]
    highest, lowest = (
        values.new_zeros(number).scatter_reduce_(0, pillar, z, how, include_self=False)
        for how in ("amax", "amin")
    )
    heights = torch.stack((mean[:, 0], highest, lowest), dim=1) + GROUND_SHIFT_M
    heights = torch.where(count[:, None] > 0, heights, 0.0)
    columns = (
        _slices(pillar, z, number, grid),
        PILLAR_COUNT_SCALE * torch.log1p(count)[:, None],
        heights,
        mean[:, 1:],
    )
    together = torch.cat(columns, dim=1).float()
    return together.reshape(grid.rows, grid.columns, -1).permute(2, 0, 1)


def mirror_pillars(
    pillars: Float32[Tensor, "batch channels rows columns"], grid: PillarGridConfig
) -> Float32[Tensor, "batch channels rows columns"]:
    """Mirror maps left to right, on a grid that reaches as far to the left as to the right.

    A point on the border of two pillars is then in another pillar than after mirroring the points.
    """
    mirrored = pillars.flip(-1)
    mirrored[:, grid.slices + _ASIDE_AFTER_SLICES] *= -1
    return mirrored


def _within(
    place: Float64[Tensor, "num_points 2"],
    z: Float64[Tensor, " num_points"],
    grid: PillarGridConfig,
) -> Bool[Tensor, " num_points"]:
    """Mask of the points inside the grid; NaN places are outside."""
    size = place.new_tensor([grid.rows, grid.columns])
    inside = ((place >= 0) & (place < size)).all(dim=1)
    return inside & (z >= grid.z_m[0]) & (z <= grid.z_m[1])


def _slices(
    pillar: Int64[Tensor, " num_points"],
    z: Float64[Tensor, " num_points"],
    number: int,
    grid: PillarGridConfig,
) -> Float64[Tensor, "number slices"]:
    """Compute how close points come to each height; points beyond the ends count at the end."""
    level = ((z - grid.lowest_slice_m) / grid.slice_m).clamp(0, grid.slices - 1)
    below = level.floor()
    share = level - below
    occupied = z.new_zeros(number * grid.slices)
    first = pillar * grid.slices + below.long()
    occupied.scatter_reduce_(0, first, 1 - share, "amax")
    is_between = share > 0  # the last height has no next one
    occupied.scatter_reduce_(0, first[is_between] + 1, share[is_between], "amax")
    return occupied.reshape(number, grid.slices)

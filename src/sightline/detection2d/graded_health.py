"""Graded health of both sensors: how much of its signal each cell of a broken image still holds.

Targets of the gates for every kind of corruption, also of those that damage a picture or a sweep
as a whole and leave something: noise, blur, glare, dirt, fog, false or moved points.
"""

from dataclasses import replace
from typing import Final

import torch
import torch.nn.functional as F
from jaxtyping import Float32, Float64
from torch import Tensor

from sightline.corruptions.corruption import Corrupted
from sightline.detection2d.loss import CELL_PX
from sightline.detection2d.placement import padded
from sightline.geometry.projection import project_points
from sightline.structures.sample import CameraLidarSample

_FLOOR: Final = (3 / 255) ** 2
"""Variance of a sound picture's own noise; cells with less detail are unknown."""
_WINDOW_CELLS: Final = 3  # side of the square around a cell in which its detail is measured
_TOLERANCE_M: Final = 0.3
"""Distance by which a moved point loses half of its health."""
_HEALTH: Final = 3  # column of a sweep in place of the reflectance


def camera_health(
    sound: Float32[Tensor, "3 height width"],
    broken: Float32[Tensor, "3 height width"],
    size: tuple[int, int],
) -> Float32[Tensor, "1 rows columns"]:
    """Compute signal^2 / (signal^2 + damage^2) of each cell, relative to the sound image's value.

    The signal is the part of the broken image that follows the sound one linearly, around each
    cell; the damage is the rest, and the noise of any camera. So a darker image is as sound as
    long as it stands out from the noise. NaN (unknown): cells without detail, or beyond the image.

    Args:
        sound: Image in [0, 1].
        broken: The same view of the corrupted image.
        size: Height, width [px] of the padded image.
    """
    products = torch.stack(
        (*sound, *broken, *(sound * sound), *(broken * broken), *(sound * broken))
    )
    is_image = torch.ones_like(sound[:1])
    sums = _cell_sums(torch.cat((products, is_image)), size)
    means = sums[:-1] / sums[-1:].clamp(min=1)
    mean_sound, mean_broken, square_sound, square_broken, product = means.reshape(
        5, 3, *means.shape[1:]
    )
    variance = (square_sound - mean_sound**2).mean(dim=0).clamp(min=0)
    broken_variance = (square_broken - mean_broken**2).mean(dim=0).clamp(min=0)
    covariance = (product - mean_sound * mean_broken).mean(dim=0).clamp(min=0)
    signal = covariance**2 / variance.clamp(min=_FLOOR)
    kept = signal / (torch.maximum(broken_variance, signal) + _FLOOR)
    health = (kept * (variance + _FLOOR) / variance.clamp(min=_FLOOR)).clamp(max=1)
    is_inside = F.avg_pool2d(padded(is_image, size), CELL_PX, ceil_mode=True)[0] > 0
    is_known = (variance > _FLOOR) & is_inside
    return torch.where(is_known, health, torch.nan)[None].float()


def with_point_health(sound: CameraLidarSample, corrupted: Corrupted) -> CameraLidarSample:
    """Put the health of each point in place of its reflectance; false points are added with 0.

    A sound point keeps 1 where the corrupted sweep has it in its place, half where it is moved by
    0.3 m, and 0 where it is lost.
    """
    points, sources, given = sound.points, corrupted.point_sources, corrupted.sample.points
    if points is None:
        return sound
    valued = points.clone()
    valued[:, _HEALTH] = 1.0
    if sources is not None and given is not None:
        rows = sources[sources >= 0]
        moved_m = (given[sources >= 0, :3] - points[rows, :3]).norm(dim=1)
        valued[:, _HEALTH] = 0.0
        valued[rows, _HEALTH] = 1 / (1 + (moved_m / _TOLERANCE_M) ** 2)
        false = given[sources < 0].clone()
        false[:, _HEALTH] = 0.0
        valued = torch.cat((valued, false))
    return replace(sound, points=valued)


def lidar_health(
    view: CameraLidarSample, size: tuple[int, int]
) -> Float32[Tensor, "1 rows columns"]:
    """Average the health of the points in each cell; NaN (unknown): no point.

    Args:
        view: View of a sample of `with_point_health`.
        size: Height, width [px] of the padded image.
    """
    rows, columns = (-(-side // CELL_PX) for side in size)
    sums = torch.zeros(2, rows * columns)
    if view.points is not None and len(view.points):
        projected = project_points(view.points[:, :3].double(), view.calibration)
        is_seen = projected.in_image(view.image_size)
        column, row = (projected.pixels[is_seen] + 0.5).floor().long().unbind(dim=1)
        cell = row // CELL_PX * columns + column // CELL_PX
        values = view.points[is_seen, _HEALTH]
        sums.index_add_(1, cell, torch.stack((values, torch.ones_like(values))))
    health = torch.where(sums[1] > 0, sums[0] / sums[1].clamp(min=1), torch.nan)
    return health.reshape(1, rows, columns)


def _cell_sums(
    planes: Float32[Tensor, "planes height width"], size: tuple[int, int]
) -> Float64[Tensor, "planes rows columns"]:
    """Sum planes over the window around each cell; nothing lies beyond the image."""
    cells = F.avg_pool2d(padded(planes, size).double(), CELL_PX, ceil_mode=True, divisor_override=1)
    half = _WINDOW_CELLS // 2
    return F.avg_pool2d(cells, _WINDOW_CELLS, stride=1, padding=half, divisor_override=1)

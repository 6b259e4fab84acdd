"""Mutual occlusion of two merged point clouds, as a LiDAR would see them."""

import math
from typing import Final, NamedTuple

import torch
from jaxtyping import Bool, Float, Float64, Int64
from torch import Tensor

AZIMUTH_STEP: Final = math.radians(0.25)
"""Width of a ray: larger than the sensor's step, so that a surface has no gaps."""
ELEVATION_STEP: Final = math.radians(0.42)
"""Height of a ray: about the spacing of 64 beams."""


class Visible(NamedTuple):
    """Masks of the visible points."""

    scene: Bool[Tensor, " num_scene"]
    pasted: Bool[Tensor, " num_pasted"]


class _Rays(NamedTuple):
    """Ray and range of each point."""

    azimuth: Int64[Tensor, " num_points"]
    elevation: Int64[Tensor, " num_points"]
    range_m: Float64[Tensor, " num_points"]


def visible_together(
    scene: Float[Tensor, "num_scene 3"], pasted: Float[Tensor, "num_pasted 3"], *, slack_m: float
) -> Visible:
    """Find the points [m] of a sweep and of a pasted object that do not hide each other.

    A point is hidden by a point of the other cloud on the same ray whose ground distance is smaller
    by more than the slack. For points of the sweep, the rays to the left and right count too, so
    that an object has no gaps. A cloud does not hide itself. Rays do not wrap around behind the
    sensor.
    """
    of_scene, of_pasted = _rays(scene), _rays(pasted)
    if len(scene) == 0 or len(pasted) == 0:
        return Visible(of_scene.range_m >= 0, of_pasted.range_m >= 0)
    low_azimuth, low_elevation = of_pasted.azimuth.amin() - 1, of_pasted.elevation.amin()
    width = int(of_pasted.azimuth.amax() - low_azimuth) + 2
    height = int(of_pasted.elevation.amax() - low_elevation) + 1

    def cells(rays: _Rays) -> tuple[Int64[Tensor, " number"], Bool[Tensor, " number"]]:
        """Cell indices in the object's area of rays, and a mask of the rays inside it."""
        column, row = rays.azimuth - low_azimuth, rays.elevation - low_elevation
        within = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        return torch.where(within, row * width + column, 0), within

    scene_cell, is_near = cells(of_scene)
    pasted_cell, _ = cells(of_pasted)
    before = _nearest(pasted_cell, of_pasted.range_m, width * height).reshape(height, width)
    beside = torch.full((height, 1), math.inf, dtype=before.dtype)
    before = torch.minimum(before, torch.cat((before[:, 1:], beside), dim=1)).minimum(
        torch.cat((beside, before[:, :-1]), dim=1)
    )
    is_hidden = is_near & (of_scene.range_m > before.flatten()[scene_cell] + slack_m)
    ahead = _nearest(scene_cell[is_near], of_scene.range_m[is_near], width * height)
    return Visible(~is_hidden, of_pasted.range_m <= ahead[pasted_cell] + slack_m)


def _rays(points: Float[Tensor, "num_points 3"]) -> _Rays:
    x, y, z = points.double().unbind(dim=1)
    range_m = torch.hypot(x, y)
    azimuth, elevation = torch.atan2(y, x), torch.atan2(z, range_m)
    return _Rays(
        (azimuth / AZIMUTH_STEP).floor().long(),
        (elevation / ELEVATION_STEP).floor().long(),
        range_m,
    )


def _nearest(
    cell: Int64[Tensor, " num_points"], range_m: Float64[Tensor, " num_points"], number: int
) -> Float64[Tensor, " {number}"]:
    empty = torch.full((number,), math.inf, dtype=range_m.dtype)
    return empty.scatter_reduce_(0, cell, range_m, "amin")

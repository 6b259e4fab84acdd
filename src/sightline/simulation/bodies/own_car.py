"""Car that carries the sensors: its body to the LiDAR on the roof, its bonnet to the camera."""

from typing import Final

import numpy as np

from sightline.simulation.bodies.cars import CARS, VANS, VehicleDesign, draw_paint
from sightline.simulation.scene import Mesh
from sightline.simulation.shapes.edits import fitted
from sightline.simulation.shapes.primitives import grid, moved

_VANS_FROM_M: Final = 1.75
_AHEAD_M: Final = (-0.6, 0.2)
"""Range of the offset of the car's middle ahead of the LiDAR."""

_LENGTH_M, _WIDTH_M = 1.1, 1.6
_CROWN_M, _SLOPE, _NOSE_M = 0.07, 0.06, 0.3  # drop to the sides, along the bonnet, at its front
_NOSE_FROM: Final = 0.75  # share of the length
_BEHIND_WINDSCREEN_M: Final = 0.5
"""Distance from the camera to the windscreen's lower edge, where the bonnet begins."""


def own_car(rng: np.random.Generator, roof_m: float) -> Mesh:
    """Build a car, or a van, whose roof is `roof_m` high, in the frame of the LiDAR's footprint."""
    model = VehicleDesign(rng, CARS if roof_m < _VANS_FROM_M else VANS).model(rng)
    length, width, _ = model.size_lwh
    body = fitted(model.shape.at(0.0), (length, width, roof_m))
    return moved(body, (float(rng.uniform(*_AHEAD_M)), 0.0, 0.0))


def bonnet(rng: np.random.Generator, *, ahead_m: float, left_m: float, height_m: float) -> Mesh:
    """Build a bonnet of a random paint, in the frame of the car's footprint.

    Args:
        rng: Source of the paint.
        ahead_m: Offset of the camera ahead of the footprint.
        left_m: Offset of the camera to the left; the bonnet's middle moves against it by half.
        height_m: Height of the bonnet's upper edge above the road.
    """
    along, across = np.linspace(0, 1, 24), np.linspace(-1, 1, 25)
    x, y = np.meshgrid(along, across, indexing="ij")
    nose = np.clip((x - _NOSE_FROM) / (1 - _NOSE_FROM), 0, None)
    z = height_m - _CROWN_M * y**2 - _SLOPE * x - _NOSE_M * nose**2
    start = ahead_m + _BEHIND_WINDSCREEN_M
    sides = _WIDTH_M / 2 * y * (1 - 0.12 * x**2) + left_m / 2
    return grid(np.stack((start + _LENGTH_M * x, sides, z), axis=-1), draw_paint(rng))

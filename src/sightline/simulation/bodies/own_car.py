"""Body of the car that carries the sensors, as its LiDAR sees it from the roof."""

from typing import Final

import numpy as np

from sightline.simulation.bodies.cars import CARS, VANS, VehicleDesign
from sightline.simulation.scene import Mesh
from sightline.simulation.shapes.edits import fitted
from sightline.simulation.shapes.primitives import moved

_VANS_FROM_M: Final = 1.75
_AHEAD_M: Final = (-0.6, 0.2)
"""Range of the offset of the car's middle ahead of the LiDAR."""


def own_car(rng: np.random.Generator, roof_m: float) -> Mesh:
    """Build a car, or a van, whose roof is `roof_m` high, in the frame of the LiDAR's footprint."""
    model = VehicleDesign(rng, CARS if roof_m < _VANS_FROM_M else VANS).model(rng)
    length, width, _ = model.size_lwh
    body = fitted(model.shape.at(0.0), (length, width, roof_m))
    return moved(body, (float(rng.uniform(*_AHEAD_M)), 0.0, 0.0))

"""Road users of varied streets: buses, special lorries, motorcycles, groups of sitting people."""

from typing import Final

import numpy as np

from sightline.simulation.bodies.heavy_vehicles import make_heavy_vehicle
from sightline.simulation.bodies.models import ActorModel
from sightline.simulation.bodies.motorcyclists import make_motorcyclist
from sightline.simulation.bodies.trucks import make_misc
from sightline.simulation.streets.layout import Ground, StreetKind
from sightline.simulation.traffic.crowd import Crowd, Fleet
from sightline.simulation.traffic.walking import stand

_MAX_HEAVY: Final = 8  # maximum heavy vehicles of different shape in a street
_ASTRIDE_M: Final = 0.45  # deviation of a motorcycle from the middle of its lane
_SEATS: Final = (2, 9)


class VariedFleet(Fleet):
    """Factory of models whose lorries are of more kinds, buses among them."""

    def __init__(self) -> None:
        super().__init__()
        self._heavy: list[ActorModel] = []

    def draw(self, rng: np.random.Generator, class_name: str, speed_mps: float) -> ActorModel:
        """Draw a road user of a KITTI class; people walk or pedal at that speed."""
        if class_name != "Truck":
            return super().draw(rng, class_name, speed_mps)
        if len(self._heavy) < _MAX_HEAVY:
            self._heavy.append(make_heavy_vehicle(rng))
            return self._heavy[-1]
        return self._heavy[int(rng.integers(len(self._heavy)))]


def ride_motorcycles(crowd: Crowd, mean: float) -> None:
    """Place motorcycles with riders in the lanes of the main road: KITTI's class is Cyclist."""
    rng, main = crowd.rng, crowd.layout.main
    lanes = [lane for lane in main.lanes if not lane.for_trams]
    for _ in range(int(rng.poisson(mean))):
        lane = lanes[int(rng.integers(len(lanes)))]
        travel = crowd.ego_travel if lane is crowd.layout.ego_lane else crowd.draw_travel(0.15)
        station = 5.0 + float(rng.gamma(2.0, 11.0))
        offset = lane.offset + float(rng.normal(0, _ASTRIDE_M))
        crowd.add(
            make_motorcyclist(rng), crowd.along(main, station, offset, lane.direction, travel), 0.4
        )


def park_motorcycles(crowd: Crowd, mean: float) -> None:
    """Place groups of motorcycles without riders beside the main road: KITTI's class is Misc."""
    rng, main = crowd.rng, crowd.layout.main
    if crowd.layout.kind is StreetKind.COUNTRY:
        return
    for _ in range(int(rng.poisson(mean))):
        side = main.left if rng.random() < 0.5 else main.right
        band = side.band(Ground.PAVEMENT) or side.bands[-1]
        station, aside = 4.0 + float(rng.gamma(2.0, 11.0)), float(rng.uniform(0.6, 1.1))
        facing = float(rng.uniform(0, 2 * np.pi)) if band.outer - band.inner > 2.5 else 0.0
        for _ in range(int(rng.integers(1, 5))):
            if any(start - 1.5 < station < stop + 1.5 for start, stop in side.gaps):
                break
            yaw = float(main.line.yaw(np.array(station))) + facing + float(rng.normal(0, 0.08))
            distance = band.outer - 1.1 if facing else (band.inner + band.outer) / 2
            stand(crowd, make_misc(rng, "motorcycle"), side, station, distance, yaw)
            station += aside if facing else 2.5


def sit_in_groups(crowd: Crowd, mean: float) -> None:
    """Place groups of people on chairs on the pavements of the main road, as before cafés."""
    rng, main = crowd.rng, crowd.layout.main
    if crowd.layout.kind is StreetKind.COUNTRY:
        return
    for _ in range(int(rng.poisson(mean))):
        side = main.left if rng.random() < 0.5 else main.right
        middle = 4.5 + float(rng.gamma(2.0, 5.0))
        for _ in range(int(rng.integers(*_SEATS))):
            station = middle + float(rng.normal(0, 1.6))
            if any(start - 1.0 < station < stop + 1.0 for start, stop in side.gaps):
                continue
            distance = side.outer - float(rng.uniform(0.5, min(2.2, side.outer - side.edge - 0.4)))
            yaw = float(rng.uniform(-np.pi, np.pi))
            model = crowd.models.draw(rng, "Person_sitting", 0.0)
            stand(crowd, model, side, station, distance, yaw)

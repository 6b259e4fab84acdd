"""Placement of road users who drive, park, cycle and walk about as often as in KITTI.

The rates in `CUSTOMS` are fitted so that the labels in the camera's view match `KITTI_COUNTS`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from sightline.simulation.crowd import Crowd
from sightline.simulation.driving import drive_lanes, fill_bays, park
from sightline.simulation.fleet import ModelSource
from sightline.simulation.layout import Layout
from sightline.simulation.lots import Bay, Lot
from sightline.simulation.motion import Travel
from sightline.simulation.occupancy import Occupancy
from sightline.simulation.scene import Actor, Motion
from sightline.simulation.turning import turn
from sightline.simulation.walking import cycle, sit, walk


class ClassCount(NamedTuple):
    """Label statistics of a class in KITTI."""

    per_frame: float
    share_of_frames: float
    """Share of frames with at least one label."""
    mean_distance_m: float


KITTI_COUNTS: Final = {
    "Car": ClassCount(3.842, 0.893, 29.3),
    "Van": ClassCount(0.390, 0.287, 36.2),
    "Truck": ClassCount(0.146, 0.138, 48.4),
    "Pedestrian": ClassCount(0.600, 0.238, 18.4),
    "Person_sitting": ClassCount(0.030, 0.013, 11.4),
    "Cyclist": ClassCount(0.217, 0.153, 25.9),
    "Tram": ClassCount(0.068, 0.047, 49.6),
}
"""Statistics of the 7,481 training label files."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Traffic:
    """All road users of a street and the ego's motion."""

    actors: tuple[Actor, ...]
    ego: Motion
    ego_travel: Travel
    taken: Occupancy
    """Ground of all road users and buildings."""


def place_traffic(
    rng: np.random.Generator,
    layout: Layout,
    lots: Sequence[Lot],
    bays: Sequence[Bay],
    models: ModelSource,
    duration_s: float,
    *,
    hard: bool = False,
) -> Traffic:
    """Fill a street for a drive of `duration_s`; no road user overlaps another or a wall.

    A `hard` street is fuller, and its cars extend into the distance.
    """
    crowd = Crowd(rng, layout, models, duration_s, hard=hard)
    crowd.block(lots)
    turn(crowd)
    drive_lanes(crowd)
    for road in layout.roads:
        for side in road.sides:
            park(crowd, road, side)
    fill_bays(crowd, bays)
    cycle(crowd)
    walk(crowd)
    sit(crowd)
    return Traffic(
        actors=tuple(crowd.actors), ego=crowd.ego, ego_travel=crowd.ego_travel, taken=crowd.taken
    )

"""Who is on a street: adds road users one by one where there is room for the whole drive."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from sightline.simulation.fleet import ModelSource
from sightline.simulation.layout import Layout, StreetKind
from sightline.simulation.lots import Lot, footprint_corners, footprint_of
from sightline.simulation.meshes.models import ActorModel
from sightline.simulation.motion import STANDING, AlongRoad, Still, Track, Travel
from sightline.simulation.occupancy import Occupancy
from sightline.simulation.scene import Actor, Pose

FASTEST_EGO_MPS: Final = 14.0
EGO_SIZE_LW: Final = (4.4, 1.9)
"""Length and width [m] of the car that carries the sensors."""
BACK_M: Final = -45.0
AHEAD_M: Final = 95.0
"""Stations between which a street is peopled."""
_MOMENT_S: Final = 0.25
"""Between the moments at which nobody may stand in anybody else."""
_VEHICLES: Final = ("Car", "Van")
"""Of which KITTI labels few far away; lorries and trams are seen from afar."""
_KEPT_AT_M: Final = ((20.0, 45.0, 60.0, 78.0), (1.0, 0.52, 0.30, 0.08))
"""Share of cars that are kept at distances [m]: annotators labelled few of the far ones."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Customs:
    """How busy streets of a kind are."""

    vehicles_per_km: float
    """Driving, per lane; the mean over streets, which differ widely."""
    heavy_share: float
    """Lorries among them."""
    van_share: float
    speed_mps: tuple[float, float]
    parked_share: tuple[float, float]
    """Range of the share of parking places taken."""
    walkers: tuple[float, float]
    """Probability of any pedestrians, and their mean number then."""
    cyclists: float
    """Mean number."""


CUSTOMS: Final = {
    StreetKind.RESIDENTIAL: Customs(
        vehicles_per_km=9.5, heavy_share=0.014, van_share=0.074, speed_mps=(3.0, 9.0),
        parked_share=(0.13, 0.62), walkers=(0.30, 3.2), cyclists=0.29,
    ),
    StreetKind.CITY: Customs(
        vehicles_per_km=13.7, heavy_share=0.030, van_share=0.081, speed_mps=(4.0, 12.0),
        parked_share=(0.18, 0.66), walkers=(0.50, 5.0), cyclists=0.49,
    ),
    StreetKind.AVENUE: Customs(
        vehicles_per_km=17.4, heavy_share=0.048, van_share=0.081, speed_mps=(7.0, 14.0),
        parked_share=(0.18, 0.53), walkers=(0.20, 2.8), cyclists=0.35,
    ),
    StreetKind.COUNTRY: Customs(
        vehicles_per_km=41.5, heavy_share=0.048, van_share=0.074, speed_mps=(9.0, 14.0),
        parked_share=(0.0, 0.0), walkers=(0.01, 1.3), cyclists=0.08,
    ),
    StreetKind.SQUARE: Customs(
        vehicles_per_km=19.9, heavy_share=0.0, van_share=0.2, speed_mps=(1.0, 3.0),
        parked_share=(0.0, 0.0), walkers=(0.75, 8.4), cyclists=0.88,
    ),
}  # fmt: skip


class Crowd:
    """The road users of a street so far, and the rates at which more are drawn."""

    def __init__(
        self, rng: np.random.Generator, layout: Layout, models: ModelSource, duration_s: float
    ) -> None:
        self.rng = rng
        self.layout = layout
        self.models = models
        self.customs = CUSTOMS[layout.kind]
        self.times = np.arange(0.0, duration_s + _MOMENT_S, _MOMENT_S)
        self.busyness = float(rng.gamma(2.0) / 2.0)
        self.actors: list[Actor] = []
        self.ego_travel = STANDING if layout.main_waits else self.draw_travel(0.12)
        self.ego = AlongRoad(
            terrain=layout.terrain,
            road=layout.main,
            station=0.0,
            offset=layout.ego_lane.offset,
            direction=1,
            travel=self.ego_travel,
        )
        self._taken = Occupancy(len(self.times))
        self._taken.try_add(self.ego.poses(self.times), *EGO_SIZE_LW)

    def block(self, lots: Sequence[Lot]) -> None:
        """Takes the ground that buildings cover."""
        for lot in lots:
            footprint = footprint_of(lot)
            if footprint is None:
                continue
            x, y = footprint_corners(footprint).mean(axis=0).tolist()
            still = Still(pose=Pose(x=x, y=y, z=0.0, yaw=footprint.yaw))
            self._taken.take(still.poses(self.times), footprint.width, footprint.depth)

    def draw_travel(self, standing_share: float) -> Travel:
        """A speed as is usual here, or standing with some probability."""
        if self.rng.random() < standing_share:
            return STANDING
        speed = float(self.rng.uniform(*self.customs.speed_mps))
        sway = float(self.rng.uniform(0.0, min(0.12 * speed, FASTEST_EGO_MPS - speed)))
        phase = float(self.rng.uniform(0, 2 * np.pi))
        return Travel(speed_mps=speed, sway_mps=sway, phase=phase)

    def draw_vehicle(self, heavy_share: float, van_share: float) -> ActorModel:
        """A lorry or a van with these probabilities, else a car."""
        chance = self.rng.random()
        name = "Car"
        if chance < heavy_share:
            name = "Truck"
        elif chance < heavy_share + van_share:
            name = "Van"
        return self.models.draw(self.rng, name, 0.0)

    def add(self, model: ActorModel, track: Track, margin: float) -> bool:
        """Adds a road user unless somebody or a wall is in the way within `margin` [m].

        Cars and vans far away are left out now and then.
        """
        if model.class_name in _VEHICLES:
            x, y = track.poses(np.zeros(1))[0, :2]
            kept = float(np.interp(np.hypot(x, y), *_KEPT_AT_M))
            # A van is larger and so labelled from farther away.
            if self.rng.random() > (kept if model.class_name == "Car" else kept**0.5):
                return False
        length, width, _ = model.size_lwh
        if not self._taken.try_add(track.poses(self.times), length, width, margin):
            return False
        self.actors.append(
            Actor(
                class_name=model.class_name,
                size_lwh=model.size_lwh,
                shape=model.shape,
                motion=track,
            )
        )
        return True


def stopping_distance_m(speed_mps: float) -> float:
    """Room that a driver keeps: half a second to react, then hard braking."""
    return 2.5 + 0.5 * speed_mps + speed_mps**2 / (2 * 7.0)

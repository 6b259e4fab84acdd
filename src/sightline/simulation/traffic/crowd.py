"""Crowd of a street: adds road users one by one where there is room for the whole drive."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, Protocol, runtime_checkable

import numpy as np

from sightline.simulation.bodies.cars import CARS, VANS, VehicleDesign
from sightline.simulation.bodies.cyclists import make_cyclist
from sightline.simulation.bodies.models import ActorModel
from sightline.simulation.bodies.people import make_pedestrian, make_sitting_person
from sightline.simulation.bodies.trams import make_tram
from sightline.simulation.bodies.trucks import make_misc, make_truck
from sightline.simulation.scene import Actor, Pose
from sightline.simulation.streets.free_ground import Occupancy
from sightline.simulation.streets.layout import Layout, Road, StreetKind
from sightline.simulation.streets.lots import Lot, footprint_corners, footprint_of
from sightline.simulation.streets.variety import Variety
from sightline.simulation.tables import read_table
from sightline.simulation.traffic.motion import STANDING, AlongRoad, Still, Track, Travel, on_wheels

_MAKERS: Final = {
    "Truck": make_truck,
    "Tram": make_tram,
    "Misc": make_misc,
    "Person_sitting": make_sitting_person,
}
_MAX_MODELS: Final = 4
"""Maximum models of a class such as Truck or Tram; making one takes longer than copying one."""
_FAMILIES: Final = {family.class_name: family for family in (CARS, VANS)}
_MAX_DESIGNS: Final = 16  # maximum designs of a street's cars or vans


@runtime_checkable
class ModelSource(Protocol):
    """Source of road user models."""

    def draw(self, rng: np.random.Generator, class_name: str, speed_mps: float) -> ActorModel:
        """Draw a road user of a KITTI class; people walk or pedal at that speed."""


class Fleet:
    """Factory of models on demand; those beyond the first few share designs or shapes."""

    def __init__(self) -> None:
        self._designs: dict[str, list[VehicleDesign]] = {}
        self._made: dict[str, list[ActorModel]] = {}

    def draw(self, rng: np.random.Generator, class_name: str, speed_mps: float) -> ActorModel:
        """Draw a road user of a KITTI class; people walk or pedal at that speed."""
        if class_name == "Pedestrian":
            return make_pedestrian(rng, speed_mps)
        if class_name == "Cyclist":
            return make_cyclist(rng, speed_mps)
        if class_name in _FAMILIES:
            designs = self._designs.setdefault(class_name, [])
            if len(designs) < _MAX_DESIGNS:
                designs.append(VehicleDesign(rng, _FAMILIES[class_name]))
                return designs[-1].model(rng)
            return designs[int(rng.integers(len(designs)))].model(rng)
        made = self._made.setdefault(class_name, [])
        if len(made) < _MAX_MODELS:
            made.append(_MAKERS[class_name](rng))
            return made[-1]
        return made[int(rng.integers(len(made)))]


FASTEST_EGO_MPS: Final = 14.0
EGO_SIZE_LW: Final = (4.4, 1.9)  # length and width [m] of the car that carries the sensors
BACK_M: Final = -45.0
AHEAD_M: Final = 125.0  # range of stations with road users
_MOMENT_S: Final = 0.25  # interval between the moments at which overlaps are checked
_EGO_ROOM_M: Final = 1.4  # free space in front of the ego and behind it
_EGO_WHEELS_LW: Final = (2.7, 1.55)
_WHEELS: Final = {
    **dict.fromkeys(("Car", "Van", "Truck", "Misc"), (0.6, 0.85)),
    "Tram": (0.7, 0.6),
    "Cyclist": (0.6, 0.0),
}
"""Wheelbase and track width as shares of length and width; others stay upright."""
_VEHICLES: Final = ("Car", "Van", "Misc")
"""Classes rarely labelled by KITTI at a distance, unlike lorries and trams."""
_KEPT_AT_M: Final = ((20.0, 45.0, 60.0, 78.0), (1.0, 0.53, 0.42, 0.23))
"""Share of cars kept at each distance [m]: annotators labelled few distant ones."""
_SPREAD: Final = 1.7
"""Concentration of the share of parking places taken: a lower value gives more rows that are full
or empty."""
_JAM_MPS: Final = (0.4, 2.5)
_MOST_HEAVY: Final = 0.25  # maximum share of lorries and buses
_HARD_BUSYNESS: Final = 1.6
_HARD_RARITY: Final = 0.4


@dataclass(frozen=True, kw_only=True, slots=True)
class TrafficRates:
    """Traffic rates for a kind of street."""

    vehicles_per_km: float  # moving vehicles per lane; the mean over streets, which differ widely
    heavy_share: float  # share of lorries among the vehicles
    van_share: float
    speed_mps: tuple[float, float]
    jam_share: float  # share of streets with a traffic jam
    parked_share: float
    """Mean share of parking places taken; most rows are nearly full or nearly empty."""
    walkers: tuple[float, float]
    """Probability of any pedestrians, and their mean number if there are any."""
    cyclists: float  # mean number of cyclists


TRAFFIC_RATES: Final = {
    StreetKind[name]: TrafficRates(**row)
    for name, row in read_table(__file__, "traffic_rates").items()
}


def _rates(kind: StreetKind, variety: Variety | None) -> TrafficRates:
    """Look up the rates of a kind of street, with the factors of its variety."""
    rates = TRAFFIC_RATES[kind]
    if variety is None:
        return rates
    return replace(
        rates,
        cyclists=rates.cyclists * variety.cyclists,
        heavy_share=min(rates.heavy_share * variety.heavy, _MOST_HEAVY),
    )


class Crowd:
    """Road users placed so far in a street, and the rates for drawing more."""

    def __init__(
        self,
        rng: np.random.Generator,
        layout: Layout,
        models: ModelSource,
        duration_s: float,
        *,
        hard: bool = False,
        variety: Variety | None = None,
    ) -> None:
        self.rng = rng
        self.layout = layout
        self.models = models
        self.rates = _rates(layout.kind, variety)
        self.times = np.arange(0.0, duration_s + _MOMENT_S, _MOMENT_S)
        self.hard = hard
        self.busyness = float(rng.gamma(2.0) / 2.0) * (_HARD_BUSYNESS if hard else 1.0)
        self.is_jammed = bool(rng.random() < self.rates.jam_share * self.busyness)
        mean = self.rates.parked_share
        self.fullness = float(rng.beta(_SPREAD * mean, _SPREAD * (1 - mean))) if mean > 0 else 0.0
        if hard:
            self.fullness = self.fullness**0.5
        self.actors: list[Actor] = []
        self.ego_travel = STANDING if layout.main_waits else self.draw_travel(0.12)
        self.ego = AlongRoad(
            terrain=layout.terrain,
            road=layout.main,
            station=0.0,
            offset=layout.ego_lane.offset,
            direction=1,
            travel=self.ego_travel,
            wheels_lw=_EGO_WHEELS_LW,
        )
        self.taken = Occupancy(len(self.times))
        length, width = EGO_SIZE_LW
        self.taken.take(self.ego.poses(self.times), length + 2 * _EGO_ROOM_M, width)

    def block(self, lots: Sequence[Lot]) -> None:
        """Mark the ground of buildings as occupied."""
        for lot in lots:
            footprint = footprint_of(lot)
            if footprint is None:
                continue
            x, y = footprint_corners(footprint).mean(axis=0).tolist()
            still = Still(pose=Pose(x=x, y=y, z=0.0, yaw=footprint.yaw))
            self.taken.take(still.poses(self.times), footprint.width, footprint.depth)

    def along(
        self,
        road: Road,
        station: float,
        offset: float,
        direction: int,
        travel: Travel,
        turn: float = 0.0,
    ) -> AlongRoad:
        """Build a motion along a road of this street; see the fields of `AlongRoad`."""
        return AlongRoad(
            terrain=self.layout.terrain,
            road=road,
            station=station,
            offset=offset,
            direction=direction,
            travel=travel,
            turn=turn,
        )

    def draw_travel(self, standing_share: float) -> Travel:
        """Draw a usual speed for this kind of street, or 0 with some probability."""
        if self.rng.random() < standing_share:
            return STANDING
        speed = float(self.rng.uniform(*(_JAM_MPS if self.is_jammed else self.rates.speed_mps)))
        sway = float(self.rng.uniform(0.0, min(0.12 * speed, FASTEST_EGO_MPS - speed)))
        phase = float(self.rng.uniform(0, 2 * np.pi))
        return Travel(speed_mps=speed, sway_mps=sway, phase=phase)

    def draw_vehicle(
        self, heavy_share: float, van_share: float, misc_share: float = 0.0
    ) -> ActorModel:
        """Draw a lorry, a van or a "Misc" vehicle with these probabilities, otherwise a car."""
        shares = (heavy_share, van_share, misc_share)
        row = int(np.searchsorted(np.cumsum(shares), self.rng.random(), side="right"))
        return self.models.draw(self.rng, ("Truck", "Van", "Misc", "Car")[row], 0.0)

    def draw_rarity(self) -> float:
        """Draw how fast a row of cars thins out with distance, for `add`; 0: not at all."""
        return float(self.rng.random()) * (_HARD_RARITY if self.hard else 1.0)

    def add(self, model: ActorModel, track: Track, margin: float, rarity: float = 0.0) -> bool:
        """Add a road user unless another or a wall is within `margin` [m].

        Distant cars and vans are left out at random, more of them for a high `rarity`.
        """
        if model.class_name in _VEHICLES:
            x, y = track.poses(np.zeros(1))[0, :2]
            kept = float(np.interp(np.hypot(x, y), *_KEPT_AT_M))
            # A van is larger and is therefore labelled at a greater distance.
            chance = (rarity + float(self.rng.random())) / 2 if rarity > 0 else 0.0
            if chance > (kept if model.class_name == "Car" else kept**0.5):
                return False
        length, width, _ = model.size_lwh
        if model.class_name in _WHEELS:
            along, across = _WHEELS[model.class_name]
            track = on_wheels(track, self.layout.terrain, (along * length, across * width))
        if not self.taken.try_add(track.poses(self.times), length, width, margin):
            return False
        self.actors.append(
            Actor(
                class_name=model.class_name,
                size_lwh=model.size_lwh,
                shape=model.shape,
                motion=track,
                labelled_lwh=model.labelled_lwh,
            )
        )
        return True


def stopping_distance_m(speed_mps: float) -> float:
    """Compute a driver's safe distance: half a second of reaction, then hard braking."""
    return 2.5 + 0.5 * speed_mps + speed_mps**2 / (2 * 7.0)

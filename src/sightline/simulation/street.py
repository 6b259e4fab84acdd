"""Street maker: ground, buildings, plants, objects, traffic, and the light of its weather."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from sightline.simulation.scene import Actor, Light, Mesh, Motion, Street
from sightline.simulation.streets.dressing import dress
from sightline.simulation.streets.free_ground import Occupancy
from sightline.simulation.streets.ground import make_ground
from sightline.simulation.streets.layout import Layout, StreetKind
from sightline.simulation.streets.layout_drawing import draw_layout
from sightline.simulation.streets.lots import Bay, Lot, bays_of, draw_lots, with_lowered_kerbs
from sightline.simulation.streets.markings import make_markings
from sightline.simulation.surroundings.plots import make_horizon, make_plots
from sightline.simulation.traffic.crowd import FASTEST_EGO_MPS, Crowd, Fleet, ModelSource
from sightline.simulation.traffic.driving import drive_lanes, fill_bays, park, turn
from sightline.simulation.traffic.motion import Travel, draw_rocking
from sightline.simulation.traffic.walking import cycle, sit, walk


class ClassCount(NamedTuple):
    """Label statistics of a class in KITTI."""

    per_frame: float
    share_of_frames: float  # share of frames with at least one label
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
    taken: Occupancy  # ground of all road users and buildings


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


_CLEAR: Final = 0.52
_CLOUDY: Final = 0.75
_LOW_SUN: Final = 0.85
_OVERCAST: Final = 0.95
"""Cumulative shares of each weather; the rest is dusk. KITTI was recorded by day."""


def draw_light(rng: np.random.Generator) -> Light:
    """Draw the light of a street: mostly a clear or partly cloudy day."""
    weather = rng.random()
    azimuth = float(rng.uniform(-np.pi, np.pi))
    if weather < _CLEAR:
        return _day(rng, azimuth, cloud_cover=float(rng.uniform(0.0, 0.25)))
    if weather < _CLOUDY:
        return _day(rng, azimuth, cloud_cover=float(rng.uniform(0.35, 0.6)))
    if weather < _LOW_SUN:
        return _low_sun(rng, azimuth)
    if weather < _OVERCAST:
        return _overcast(rng, azimuth)
    return _dusk(rng, azimuth)


def _sun_direction(elevation: float, azimuth: float) -> tuple[float, float, float]:
    return (
        float(np.cos(elevation) * np.cos(azimuth)),
        float(np.cos(elevation) * np.sin(azimuth)),
        float(np.sin(elevation)),
    )


def _scaled(color: tuple[float, float, float], factor: float) -> tuple[float, float, float]:
    red, green, blue = color
    return red * factor, green * factor, blue * factor


def _day(rng: np.random.Generator, azimuth: float, cloud_cover: float) -> Light:
    """Draw a day with the sun 22 to 55 degrees high; irradiance of 7 to 11 units on the ground."""
    elevation = float(np.radians(rng.uniform(22.0, 55.0)))
    strength = 12.0 * (1.0 - 0.25 * cloud_cover)
    warmth = float(np.clip((elevation - 0.3) / 0.6, 0.0, 1.0))
    return Light(
        sun_direction=_sun_direction(elevation, azimuth),
        sun_color=_scaled((1.0, 0.90 + 0.05 * warmth, 0.74 + 0.12 * warmth), strength),
        sun_softness=0.0047 + 0.01 * cloud_cover,
        sky_zenith=_scaled((0.30, 0.55, 1.0), 0.40 + 0.5 * cloud_cover),
        sky_horizon=_scaled((0.80, 0.92, 1.0), 0.72 + 0.4 * cloud_cover),
        cloud_cover=cloud_cover,
        haze_m=float(rng.uniform(900.0, 2500.0)),
        exposure=float(rng.uniform(0.23, 0.32)),
    )


def _low_sun(rng: np.random.Generator, azimuth: float) -> Light:
    """Draw a low sun with long shadows and warm light."""
    elevation = float(np.radians(rng.uniform(7.0, 18.0)))
    return Light(
        sun_direction=_sun_direction(elevation, azimuth),
        sun_color=_scaled((1.0, 0.74, 0.46), 6.5),
        sun_softness=0.006,
        sky_zenith=_scaled((0.32, 0.52, 0.95), 0.75),
        sky_horizon=_scaled((1.0, 0.88, 0.72), 1.25),
        cloud_cover=float(rng.uniform(0.0, 0.4)),
        haze_m=float(rng.uniform(500.0, 1200.0)),
        exposure=float(rng.uniform(0.38, 0.52)),
    )


def _overcast(rng: np.random.Generator, azimuth: float) -> Light:
    """Draw an overcast sky, without shadows."""
    return Light(
        sun_direction=_sun_direction(0.9, azimuth),
        sun_color=(0.0, 0.0, 0.0),
        sun_softness=0.05,
        sky_zenith=_scaled((0.92, 0.97, 1.05), 1.45),
        sky_horizon=_scaled((0.96, 0.98, 1.0), 1.25),
        cloud_cover=float(rng.uniform(0.9, 1.0)),
        haze_m=float(rng.uniform(350.0, 900.0)),
        exposure=float(rng.uniform(0.50, 0.68)),
    )


def _dusk(rng: np.random.Generator, azimuth: float) -> Light:
    """Draw dusk: the sun is down, lamps are lit."""
    return Light(
        sun_direction=_sun_direction(0.05, azimuth),
        sun_color=(0.0, 0.0, 0.0),
        sun_softness=0.02,
        sky_zenith=_scaled((0.28, 0.42, 0.85), 0.22),
        sky_horizon=_scaled((1.0, 0.72, 0.55), 0.26),
        cloud_cover=float(rng.uniform(0.0, 0.5)),
        haze_m=float(rng.uniform(500.0, 1000.0)),
        exposure=float(rng.uniform(1.8, 2.6)),
    )


def make_street(
    rng: np.random.Generator,
    *,
    duration_s: float = 0.0,
    kind: StreetKind | None = None,
    hard: bool = False,
    hard_negatives: bool = False,
) -> Street:
    """Draw a street with its traffic and weather.

    Args:
        rng: Source of all randomness; the same state gives the same street.
        duration_s: Duration of the ego's drive. No road users collide until then, and the street is
            long enough.
        kind: Kind of street; None draws it.
        hard: Whether it is fuller and hillier than usual, with more objects far away and hidden.
        hard_negatives: Whether to place many objects that are easily mistaken for a person or a
            car.

    Raises:
        ValueError: `duration_s` is negative.
    """
    if duration_s < 0:
        raise ValueError(f"duration_s must not be negative, got {duration_s}")
    layout = draw_layout(rng, kind, extra_length_m=FASTEST_EGO_MPS * duration_s, hard=hard)
    lots = draw_lots(rng, layout)
    layout = with_lowered_kerbs(layout, lots)
    bays = bays_of(rng, lots)
    traffic = place_traffic(rng, layout, lots, bays, Fleet(), duration_s, hard=hard)
    parts = [make_ground(rng, layout), make_markings(rng, layout)]
    parts += make_plots(rng, layout, lots)
    parts += make_horizon(rng, layout)
    parts += dress(rng, layout, traffic.taken, hard_negatives=hard_negatives)
    return Street(
        ground_and_buildings=Mesh.joined(parts),
        actors=traffic.actors,
        ego=draw_rocking(rng, traffic.ego),
        light=draw_light(rng),
    )

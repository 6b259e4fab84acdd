"""Street maker: ground, buildings, plants, objects, traffic, and the light of its weather."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from sightline.simulation.rays.surfaces import WET
from sightline.simulation.scene import Light, Material, Mesh, Street
from sightline.simulation.shapes.primitives import Color
from sightline.simulation.streets.dressing import dress
from sightline.simulation.streets.ground import make_ground
from sightline.simulation.streets.layout import Layout, StreetKind
from sightline.simulation.streets.layout_drawing import draw_layout
from sightline.simulation.streets.lots import Bay, Lot, bays_of, draw_lots, with_lowered_kerbs
from sightline.simulation.streets.markings import make_markings
from sightline.simulation.streets.variety import Variety, draw_variety
from sightline.simulation.surroundings.plots import make_horizon, make_plots
from sightline.simulation.traffic.crowd import FASTEST_EGO_MPS, Crowd, Fleet, ModelSource
from sightline.simulation.traffic.driving import drive_lanes, fill_bays, park, turn
from sightline.simulation.traffic.motion import draw_rocking
from sightline.simulation.traffic.varied_traffic import (
    VariedFleet,
    park_motorcycles,
    ride_motorcycles,
    sit_in_groups,
)
from sightline.simulation.traffic.walking import cycle, sit, walk


def place_traffic(
    rng: np.random.Generator,
    layout: Layout,
    lots: Sequence[Lot],
    bays: Sequence[Bay],
    models: ModelSource,
    duration_s: float,
    *,
    hard: bool = False,
    variety: Variety | None = None,
) -> Crowd:
    """Fill a street for a drive of `duration_s`; no road user overlaps another or a wall.

    A `hard` street is fuller, and its cars extend into the distance.
    """
    crowd = Crowd(rng, layout, models, duration_s, hard=hard, variety=variety)
    crowd.block(lots)
    turn(crowd)
    drive_lanes(crowd)
    for road in layout.roads:
        for side in road.sides:
            park(crowd, road, side)
    fill_bays(crowd, bays)
    if variety is not None:
        ride_motorcycles(crowd, variety.motorcycles)
        park_motorcycles(crowd, variety.motorcycles)
    cycle(crowd)
    walk(crowd)
    sit(crowd)
    if variety is not None:
        sit_in_groups(crowd, variety.sitting)
    return crowd


_CLEAR: Final = 0.52
_CLOUDY: Final = 0.75
_LOW_SUN: Final = 0.85
_OVERCAST: Final = 0.95
"""Cumulative shares of each weather; the rest is dusk. KITTI was recorded by day."""
_RAIN_CLOUDS: Final = 0.8  # share of wet streets with an overcast sky
_NO_SUN: Final = (0.0, 0.0, 0.0)


def draw_light(rng: np.random.Generator, variety: Variety | None = None) -> Light:
    """Draw the light of a street: mostly a clear or partly cloudy day; `variety` may want another.

    Wet streets mostly have an overcast sky.
    """
    weather = rng.random()
    if variety is not None and variety.is_dusk:
        return _nightfall(rng)
    if variety is not None and variety.is_wet and rng.random() < _RAIN_CLOUDS:
        weather = (_LOW_SUN + _OVERCAST) / 2
    azimuth = float(rng.uniform(-np.pi, np.pi))
    if weather < _CLEAR:
        return _day(rng, azimuth, float(rng.uniform(0.0, 0.25)))
    if weather < _CLOUDY:
        return _day(rng, azimuth, float(rng.uniform(0.35, 0.6)))
    if weather < _LOW_SUN:  # long shadows and warm light
        elevation, cover = float(np.radians(rng.uniform(7.0, 18.0))), float(rng.uniform(0.0, 0.4))
        sun, zenith, horizon = (1.0, 0.74, 0.46), (0.32, 0.52, 0.95), (1.0, 0.88, 0.72)
        colors = _scaled(sun, 6.5), _scaled(zenith, 0.75), _scaled(horizon, 1.25)
        softness, haze_m, exposure = 0.006, (500.0, 1200.0), (0.38, 0.52)
    elif weather < _OVERCAST:  # without shadows
        elevation, cover = 0.9, float(rng.uniform(0.9, 1.0))
        colors = _NO_SUN, _scaled((0.92, 0.97, 1.05), 1.45), _scaled((0.96, 0.98, 1.0), 1.25)
        softness, haze_m, exposure = 0.05, (350.0, 900.0), (0.50, 0.68)
    else:  # the sun is down, lamps are lit
        elevation, cover = 0.05, float(rng.uniform(0.0, 0.5))
        colors = _NO_SUN, _scaled((0.28, 0.42, 0.85), 0.22), _scaled((1.0, 0.72, 0.55), 0.26)
        softness, haze_m, exposure = 0.02, (500.0, 1000.0), (1.8, 2.6)
    return _light(rng, (elevation, azimuth), colors, softness, cover, haze_m, exposure)


def _nightfall(rng: np.random.Generator) -> Light:
    """Draw the end of dusk: a dark sky, and pictures that stay dark, with lamps lit."""
    azimuth, darkness = float(rng.uniform(-np.pi, np.pi)), float(rng.uniform(0.25, 0.8))
    colors = (
        _NO_SUN,
        _scaled((0.28, 0.40, 0.80), 0.22 * darkness),
        _scaled((1.0, 0.72, 0.55), 0.26 * darkness),
    )
    cover = float(rng.uniform(0.0, 0.9))
    return _light(rng, (0.05, azimuth), colors, 0.02, cover, (400.0, 1000.0), (0.9, 1.5))


def _day(rng: np.random.Generator, azimuth: float, cover: float) -> Light:
    """Draw a day with the sun 22 to 55 degrees high; irradiance of 7 to 11 units on the ground."""
    elevation = float(np.radians(rng.uniform(22.0, 55.0)))
    warmth = float(np.clip((elevation - 0.3) / 0.6, 0.0, 1.0))
    colors = (
        _scaled((1.0, 0.90 + 0.05 * warmth, 0.74 + 0.12 * warmth), 12.0 * (1.0 - 0.25 * cover)),
        _scaled((0.30, 0.55, 1.0), 0.40 + 0.5 * cover),
        _scaled((0.80, 0.92, 1.0), 0.72 + 0.4 * cover),
    )
    softness = 0.0047 + 0.01 * cover
    return _light(rng, (elevation, azimuth), colors, softness, cover, (900.0, 2500.0), (0.23, 0.32))


def _light(
    rng: np.random.Generator,
    sun_angles: tuple[float, float],
    colors: tuple[Color, Color, Color],
    softness: float,
    cover: float,
    haze_m: tuple[float, float],
    exposure: tuple[float, float],
) -> Light:
    """Draw haze and exposure; angles: elevation, azimuth [rad]; colors: sun, zenith, horizon."""
    elevation, azimuth = sun_angles
    return Light(
        sun_direction=(
            float(np.cos(elevation) * np.cos(azimuth)),
            float(np.cos(elevation) * np.sin(azimuth)),
            float(np.sin(elevation)),
        ),
        sun_color=colors[0],
        sun_softness=softness,
        sky_zenith=colors[1],
        sky_horizon=colors[2],
        cloud_cover=cover,
        haze_m=float(rng.uniform(*haze_m)),
        exposure=float(rng.uniform(*exposure)),
    )


def _scaled(color: Color, factor: float) -> Color:
    red, green, blue = color
    return red * factor, green * factor, blue * factor


def make_street(
    rng: np.random.Generator,
    *,
    duration_s: float = 0.0,
    kind: StreetKind | None = None,
    hard: bool = False,
    hard_negatives: bool = False,
    varied: bool = False,
) -> Street:
    """Draw a street with its traffic and weather; the same state of `rng` gives the same street.

    Args:
        rng: Source of all randomness.
        duration_s: Duration of the ego's drive. No road users collide until then, and the street is
            long enough.
        kind: Kind of street; None draws it.
        hard: Whether it is fuller and hillier than usual, with more objects far away and hidden.
        hard_negatives: Whether to place many objects easily mistaken for a person or a car.
        varied: Whether streets differ as much as other rigs than KITTI's meet them: `Variety`.

    Raises:
        ValueError: `duration_s` is negative.
    """
    if duration_s < 0:
        raise ValueError(f"duration_s must not be negative, got {duration_s}")
    variety = draw_variety(rng) if varied else None
    if variety is not None and kind is None:
        kind = variety.kind
    layout = draw_layout(
        rng,
        kind,
        extra_length_m=FASTEST_EGO_MPS * duration_s,
        hard=hard,
        wide=variety is not None and variety.has_wide_junction,
    )
    lots = draw_lots(rng, layout)
    layout = with_lowered_kerbs(layout, lots)
    bays = bays_of(rng, lots)
    fleet = Fleet() if variety is None else VariedFleet()
    traffic = place_traffic(rng, layout, lots, bays, fleet, duration_s, hard=hard, variety=variety)
    parts = [make_ground(rng, layout), make_markings(rng, layout)]
    parts += make_plots(rng, layout, lots, variety)
    parts += make_horizon(rng, layout)
    rows = 0.0 if variety is None else variety.bicycle_rows
    parts += dress(rng, layout, traffic.taken, hard_negatives=hard_negatives, bicycle_rows=rows)
    mesh = Mesh.joined(parts)
    return Street(
        ground_and_buildings=wetted(mesh) if variety is not None and variety.is_wet else mesh,
        actors=tuple(traffic.actors),
        ego=draw_rocking(rng, traffic.ego),
        light=draw_light(rng, variety),
    )


def wetted(mesh: Mesh) -> Mesh:
    """Give roads and pavements the wet surfaces of their materials."""
    table = np.arange(len(Material), dtype=np.int32)
    for dry, wet in WET.items():
        table[dry] = wet
    return replace(mesh, materials=table[mesh.materials])

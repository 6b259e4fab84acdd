"""Surface heights of a road: hills, crown, kerbs and lowered kerbs."""

from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Float64

from sightline.simulation.layout import Road, Side
from sightline.simulation.layout_line import Terrain

_CROWN_FADE_M: Final = 10.0
"""Distance before a junction over which the crown flattens out, as two road surfaces meet."""
_RAMP_HALF_M: Final = 1.7
_RAMP_SLOPE_M: Final = 0.8
"""Half width of a lowered kerb, and length of the slope at each of its ends."""
RAMP_DEPTH_M: Final = 1.0
"""Distance from a lowered kerb over which the pavement rises to its full height."""
_STEP_M: Final = 0.3
"""Distance over which a person who steps onto a kerb rises to its height."""


def surface_height(
    terrain: Terrain,
    road: Road,
    stations: Float[np.ndarray, "..."],
    offsets: Float[np.ndarray, "..."],
) -> Float64[np.ndarray, "..."]:
    """Compute the height [m] of the ground on or beside a road, in the world."""
    heights = terrain.height(road.line.place(stations, offsets))
    return np.asarray(heights + surface_level(road, stations, offsets))


def surface_level(
    road: Road, stations: Float[np.ndarray, "..."], offsets: Float[np.ndarray, "..."]
) -> Float64[np.ndarray, "..."]:
    """Compute the height [m] of carriageway or bands above the terrain; kerbs are short ramps."""
    edges = np.where(np.asarray(offsets) >= 0, road.left.edge, road.right.edge)
    share = np.clip((np.abs(offsets) - edges) / _STEP_M + 0.5, 0.0, 1.0)
    bands = band_level(road, stations, offsets)
    return np.asarray(crown_level(road, stations, offsets) + share * bands)


def crown_level(
    road: Road, stations: Float[np.ndarray, "..."], offsets: Float[np.ndarray, "..."]
) -> Float64[np.ndarray, "..."]:
    """Compute the carriageway's height [m] above its edges: a parabola across, 0 in junctions."""
    edges = np.where(np.asarray(offsets) >= 0, road.left.edge, road.right.edge)
    across = np.clip(1.0 - (offsets / edges) ** 2, 0.0, 1.0)
    gaps = road.left.gaps + road.right.gaps
    apart = [np.maximum(start - stations, stations - stop) for start, stop in gaps]
    fade = [np.clip(distance / _CROWN_FADE_M, 0.0, 1.0) for distance in apart]
    along = np.minimum.reduce(fade) if fade else 1.0
    return np.asarray(road.crown_m * across * along)


def band_level(
    road: Road, stations: Float[np.ndarray, "..."], offsets: Float[np.ndarray, "..."]
) -> Float64[np.ndarray, "..."]:
    """Compute the bands' height [m] above the terrain, less at lowered kerbs, 0 in junctions."""
    is_left = np.asarray(offsets) >= 0
    levels = [_level_of(side, stations, offsets) for side in road.sides]
    return np.where(is_left, *levels)


def _level_of(
    side: Side, stations: Float[np.ndarray, "..."], offsets: Float[np.ndarray, "..."]
) -> Float64[np.ndarray, "..."]:
    stations, offsets = np.broadcast_arrays(stations, offsets)
    is_open: Bool[np.ndarray, "..."] = np.zeros(stations.shape, dtype=bool)
    for start, stop in side.gaps:
        is_open |= (stations > start) & (stations < stop)
    shares = np.ones(stations.shape)
    for ramp in side.ramps:
        away = (np.abs(stations - ramp) - _RAMP_HALF_M) / _RAMP_SLOPE_M
        shares = np.minimum(shares, np.clip(away, 0.0, 1.0))
    behind = np.clip((np.abs(offsets) - side.edge) / RAMP_DEPTH_M, 0.0, 1.0)
    return np.where(is_open, 0.0, side.level * (shares + (1.0 - shares) * behind))


def ramp_stations(side: Side) -> Float64[np.ndarray, " num_stations"]:
    """Compute the stations at which the height of a side's kerb changes slope."""
    bends = (
        np.array([-1.0, 1.0]) * _RAMP_HALF_M + np.array([[0.0, 0.0], [-1.0, 1.0]]) * _RAMP_SLOPE_M
    )
    return (np.array(side.ramps)[:, None] + bends.ravel()).ravel()

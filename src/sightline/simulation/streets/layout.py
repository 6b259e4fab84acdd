"""Street layout: centre lines, terrain, lanes, kerbs, pavements, a crossing road and the plots."""

from dataclasses import dataclass
from enum import Enum
from typing import Final

import numpy as np
from jaxtyping import Float, Float64

from sightline.simulation.arrays import Numbers, Shaped

_STEP: Final = 0.5  # spacing of a line's points [m]


@dataclass(frozen=True, kw_only=True, slots=True)
class CenterLine:
    """Smooth line with stations [m] along it; it continues straight beyond its ends.

    A point near it is (station, offset): offsets [m] are positive to the left.
    """

    first_station: float
    points: Float64[np.ndarray, "num_points 2"]  # world x, y every half metre
    yaws: Float64[np.ndarray, " num_points"]  # heading at the points [rad], without jumps

    def yaw(self, station: Float[np.ndarray, "*shape"]) -> Shaped:
        """Compute the heading [rad] at a station."""
        rows = (np.asarray(station) - self.first_station) / _STEP
        return np.asarray(np.interp(rows, np.arange(len(self.yaws)), self.yaws))

    def place(self, station: Numbers, offset: Numbers) -> Float64[np.ndarray, "... 2"]:
        """Compute world x, y at stations and offsets, which are broadcast."""
        station, offset = np.broadcast_arrays(
            np.asarray(station, np.float64), np.asarray(offset, np.float64)
        )
        rows = (station - self.first_station) / _STEP
        count = np.arange(len(self.points))
        beyond = (rows - np.clip(rows, 0, len(count) - 1)) * _STEP
        yaw = np.interp(rows, count, self.yaws)
        cos, sin = np.cos(yaw), np.sin(yaw)
        x = np.interp(rows, count, self.points[:, 0]) + beyond * cos - offset * sin
        y = np.interp(rows, count, self.points[:, 1]) + beyond * sin + offset * cos
        return np.stack((x, y), axis=-1)


def straight_line(
    start: Float64[np.ndarray, "2"], yaw: float, first_station: float, last_station: float
) -> CenterLine:
    """Build a straight line with station 0 at `start`."""
    stations = np.arange(first_station, last_station + _STEP, _STEP)
    points = start + stations[:, None] * np.array([np.cos(yaw), np.sin(yaw)])
    return CenterLine(first_station=first_station, points=points, yaws=np.full(len(stations), yaw))


def station_grid(first_station: float, last_station: float) -> Float64[np.ndarray, " num_points"]:
    """Build the grid of stations for the curvatures of `curved_line`."""
    first = np.floor(first_station / _STEP) * _STEP
    return np.arange(first, last_station + _STEP, _STEP)


def curved_line(
    stations: Float64[np.ndarray, " num_points"],
    curvatures: Float64[np.ndarray, " num_points"],
    origin_offset: float,
) -> CenterLine:
    """Build a line from curvatures [1/m]; its point (0, `origin_offset`) is the world's origin.

    At station 0, which must be in `stations`, it heads along +x.
    """
    steps = 0.5 * (curvatures[1:] + curvatures[:-1]) * _STEP
    yaws = np.concatenate(([0.0], np.cumsum(steps)))
    zero = int(np.argmin(np.abs(stations)))
    yaws -= yaws[zero]
    middle = 0.5 * (yaws[1:] + yaws[:-1])
    offsets = _STEP * np.stack((np.cos(middle), np.sin(middle)), axis=1)
    points = np.concatenate((np.zeros((1, 2)), np.cumsum(offsets, axis=0)))
    points -= points[zero] + np.array([0.0, origin_offset])
    return CenterLine(first_station=float(stations[0]), points=points, yaws=yaws)


@dataclass(frozen=True, kw_only=True, slots=True)
class Terrain:
    """Hills and bumps as sums of waves; height 0 at the world's origin."""

    wave_vectors: Float64[np.ndarray, "num_waves 2"]  # wave vectors [rad/m]
    phases: Float64[np.ndarray, " num_waves"]
    amplitudes: Float64[np.ndarray, " num_waves"]  # amplitudes [m]

    def height(self, places: Float[np.ndarray, "*shape 2"]) -> Shaped:
        """Compute the height [m] of the ground at world x, y."""
        waves = np.sin(places @ self.wave_vectors.T + self.phases) - np.sin(self.phases)
        return np.asarray(waves @ self.amplitudes)


_WAVES_M: Final = ((300.0, 600.0), (150.0, 280.0), (80.0, 130.0), (24.0, 60.0), (14.0, 30.0))
_STEEPEST: Final = (0.016, 0.013, 0.005, 0.007, 0.007)
"""Wavelengths of hills and bumps, and their maximum slopes in an average street."""
_NUM_HILLS: Final = 3
_HILLIEST: Final = 3.0


def draw_terrain(rng: np.random.Generator, *, hard: bool = False) -> Terrain:
    """Draw terrain as in KITTI's streets: mostly flat, sometimes hilly.

    It bends by at most 4 mm within 2.5 m, so that flat pieces fit it. With `hard`, hills are always
    as high as the sometimes hilly ones.
    """
    lengths = rng.uniform(*np.transpose(_WAVES_M))
    directions = rng.uniform(0, 2 * np.pi, len(lengths))
    numbers = 2 * np.pi / lengths
    hilliness = min(float(rng.exponential(1.0)) + (1.5 if hard else 0.0), _HILLIEST)
    scale = np.where(np.arange(len(lengths)) < _NUM_HILLS, hilliness, 1.0)
    steepness = scale * rng.uniform(0.0, _STEEPEST)
    return Terrain(
        wave_vectors=numbers[:, None] * np.stack((np.cos(directions), np.sin(directions)), axis=1),
        phases=rng.uniform(0, 2 * np.pi, len(lengths)),
        amplitudes=steepness / numbers,
    )


KERB_HEIGHT_M: Final = 0.12


StreetKind = Enum("StreetKind", "RESIDENTIAL CITY AVENUE COUNTRY SQUARE")  # kind of street
Parking = Enum("Parking", "NONE PARALLEL ANGLED PERPENDICULAR")
"""Arrangement of cars along the kerb."""


PARKING_DEPTH_M: Final = {
    Parking.NONE: 0.0,
    Parking.PARALLEL: 2.1,
    Parking.ANGLED: 5.1,
    Parking.PERPENDICULAR: 5.2,
}


Ground = Enum("Ground", "VERGE CYCLE_PATH PAVEMENT SHOULDER")
"""Kind of a band beside the carriageway."""


Plots = Enum("Plots", "HOUSES TERRACES APARTMENTS BLOCKS HALLS PARK FOREST FIELD CAR_PARK")
"""Kind of plots beyond the pavement."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Lane:
    """Vehicle lane of a road."""

    offset: float  # offset of its middle from the centre line [m], positive to the left
    width: float
    direction: int  # 1 along the line, -1 against it
    for_trams: bool = False


@dataclass(frozen=True, kw_only=True, slots=True)
class Band:
    """Strip of ground beside the carriageway; distances from the centre line [m]."""

    ground: Ground
    inner: float
    outer: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Side:
    """One side of a road; distances from the centre line [m], all positive."""

    sign: int  # 1 left, -1 right
    lane_edge: float  # end of the lanes and start of parking
    edge: float  # edge of the carriageway
    level: float  # height of the bands above the carriageway
    parking: Parking
    bands: tuple[Band, ...]
    plots: Plots
    setback: float  # distance between the last band and the buildings
    has_tree_row: bool = False
    gaps: tuple[tuple[float, float], ...] = ()
    """Ranges of stations where a crossing road opens this side."""
    ramps: tuple[float, ...] = ()  # stations where the kerb is lowered for driveways

    @property
    def outer(self) -> float:
        """End of the last band."""
        return self.bands[-1].outer

    def band(self, ground: Ground) -> Band | None:
        """Find the band of a kind, or None."""
        return next((band for band in self.bands if band.ground is ground), None)

    def stretches(
        self, first: float, last: float, margin: float = 0.0
    ) -> tuple[tuple[float, float], ...]:
        """Find the stretches between two stations outside the gaps, widened by `margin`."""
        cuts = [first]
        for start, stop in self.gaps:
            cuts += [start - margin, stop + margin]
        cuts.append(last)
        pairs = zip(cuts[::2], cuts[1::2], strict=True)
        return tuple((max(a, first), min(b, last)) for a, b in pairs if b - a > 0.5)


@dataclass(frozen=True, kw_only=True, slots=True)
class Road:
    """Road with its lanes and both sides."""

    line: CenterLine
    first: float
    last: float  # range of stations where the road is built
    lanes: tuple[Lane, ...]
    left: Side
    right: Side
    has_kerbs: bool
    crown_m: float = 0.0  # height of the carriageway's middle above its edges, for drainage

    @property
    def sides(self) -> tuple[Side, Side]:
        """Left and right side."""
        return self.left, self.right


@dataclass(frozen=True, kw_only=True, slots=True)
class Junction:
    """Crossing of the main road, or a road that ends at it.

    The stations of the crossing road are the offsets of the main road.
    """

    station: float
    radius: float  # radius of the kerb at the corners [m]
    corner: float  # side length of a corner's square beside both carriageways [m]
    cross: Road
    opens_left: bool
    opens_right: bool
    has_lights: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class Layout:
    """Plan of a street before anything is built."""

    kind: StreetKind
    terrain: Terrain
    main: Road
    junction: Junction | None
    ego_lane: Lane
    main_waits: bool
    """Whether the main road waits at the junction while the crossing traffic drives."""
    wooded_horizon: bool

    @property
    def roads(self) -> tuple[Road, ...]:
        """All roads of the layout."""
        return (self.main,) if self.junction is None else (self.main, self.junction.cross)


def ground_places(
    layout: Layout, road: Road, stations: Numbers, offsets: Numbers | float, level: float
) -> Float64[np.ndarray, "... 3"]:
    """Compute world points at stations and offsets of a road, at a level above the terrain."""
    places = road.line.place(np.asarray(stations, np.float64), np.asarray(offsets, np.float64))
    heights = layout.terrain.height(places) + level
    return np.concatenate((places, heights[..., None]), axis=-1)

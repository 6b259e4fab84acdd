"""Centre lines of roads, and the terrain below them."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float, Float64

_STEP: Final = 0.5  # spacing of a line's points [m]


@dataclass(frozen=True, kw_only=True, slots=True)
class CenterLine:
    """Smooth line with stations [m] along it; it continues straight beyond its ends.

    A point near it is (station, offset): offsets [m] are positive to the left.
    """

    first_station: float
    points: Float64[np.ndarray, "num_points 2"]
    """World x, y every half metre."""
    yaws: Float64[np.ndarray, " num_points"]
    """Heading at the points [rad], without jumps."""

    def yaw(self, station: Float[np.ndarray, "*shape"]) -> Float64[np.ndarray, "*shape"]:
        """Compute the heading [rad] at a station."""
        rows = (np.asarray(station) - self.first_station) / _STEP
        return np.asarray(np.interp(rows, np.arange(len(self.yaws)), self.yaws))

    def place(
        self, station: Float[np.ndarray, "..."], offset: Float[np.ndarray, "..."]
    ) -> Float64[np.ndarray, "... 2"]:
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
    ways = _STEP * np.stack((np.cos(middle), np.sin(middle)), axis=1)
    points = np.concatenate((np.zeros((1, 2)), np.cumsum(ways, axis=0)))
    points -= points[zero] + np.array([0.0, origin_offset])
    return CenterLine(first_station=float(stations[0]), points=points, yaws=yaws)


@dataclass(frozen=True, kw_only=True, slots=True)
class Terrain:
    """Hills and bumps as sums of waves; height 0 at the world's origin."""

    wave_vectors: Float64[np.ndarray, "num_waves 2"]
    """Wave vectors [rad/m]."""
    phases: Float64[np.ndarray, " num_waves"]
    amplitudes: Float64[np.ndarray, " num_waves"]
    """Amplitudes [m]."""

    def height(self, places: Float[np.ndarray, "*shape 2"]) -> Float64[np.ndarray, "*shape"]:
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

"""How the ego, vehicles and people move: smooth, exact and known for all times."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Float64

from sightline.simulation.layout import Road, surface_level
from sightline.simulation.layout_line import Terrain
from sightline.simulation.scene import Pose


@runtime_checkable
class Track(Protocol):
    """A motion whose poses at many times are known at once."""

    def at(self, time_s: float) -> Pose:
        """The pose at a time [s]."""

    def poses(self, times_s: Float[np.ndarray, " count"]) -> Float64[np.ndarray, "count 4"]:
        """World x, y, z [m] and yaw [rad] at each time."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Travel:
    """How far something has come at each time.

    Vehicles of one lane share a travel, so that the room between them never changes.
    """

    speed_mps: float
    """Mean speed."""
    sway_mps: float = 0.0
    """By how much the speed rises and falls; less than the mean, so that nothing rolls back."""
    period_s: float = 12.0
    phase: float = 0.0

    def distance(self, times_s: Float[np.ndarray, "*shape"]) -> Float64[np.ndarray, "*shape"]:
        """Distance [m] since time 0."""
        rate = 2 * np.pi / self.period_s
        waves = np.sin(rate * np.asarray(times_s) + self.phase) - np.sin(self.phase)
        times = np.asarray(times_s, np.float64)
        return np.asarray(self.speed_mps * times + self.sway_mps / rate * waves)

    def speed_at(self, time_s: float) -> float:
        """Speed [m/s] at a time."""
        rate = 2 * np.pi / self.period_s
        return float(self.speed_mps + self.sway_mps * np.cos(rate * time_s + self.phase))


STANDING = Travel(speed_mps=0.0)


@dataclass(frozen=True, kw_only=True, slots=True)
class AlongRoad:
    """Follows a road at a constant distance from its centre line."""

    terrain: Terrain
    road: Road
    station: float
    """At time 0."""
    offset: float
    direction: int
    """1 along the line, -1 against it."""
    travel: Travel
    level: float = 0.0
    """Height of the surface above the terrain [m]."""
    turn: float = 0.0
    """Heading off the direction of travel [rad], as of a car parked askew."""

    def at(self, time_s: float) -> Pose:
        """The pose at a time [s]."""
        return _pose(self.poses(np.array([time_s])))

    def poses(self, times_s: Float[np.ndarray, " count"]) -> Float64[np.ndarray, "count 4"]:
        """World x, y, z [m] and yaw [rad] at each time."""
        stations = self.station + self.direction * self.travel.distance(times_s)
        places = self.road.line.place(stations, np.array(self.offset))
        yaws = self.road.line.yaw(stations) + (0.0 if self.direction > 0 else np.pi) + self.turn
        return _rows(places, self.terrain.height(places) + self.level, yaws)


@dataclass(frozen=True, kw_only=True, slots=True)
class AcrossRoad:
    """Walks straight across a road and on, over the kerbs."""

    terrain: Terrain
    road: Road
    station: float
    offset: float
    """At time 0."""
    direction: int
    """1 to the left of the road, -1 to its right."""
    travel: Travel

    def at(self, time_s: float) -> Pose:
        """The pose at a time [s]."""
        return _pose(self.poses(np.array([time_s])))

    def poses(self, times_s: Float[np.ndarray, " count"]) -> Float64[np.ndarray, "count 4"]:
        """World x, y, z [m] and yaw [rad] at each time."""
        offsets = self.offset + self.direction * self.travel.distance(times_s)
        places = self.road.line.place(np.array(self.station), offsets)
        levels = np.array([surface_level(self.road, self.station, offset) for offset in offsets])
        yaw = float(self.road.line.yaw(np.array(self.station))) + self.direction * np.pi / 2
        return _rows(places, self.terrain.height(places) + levels, np.full(len(offsets), yaw))


@dataclass(frozen=True, kw_only=True, slots=True)
class Still:
    """Stays where it is."""

    pose: Pose

    def at(self, time_s: float) -> Pose:  # noqa: ARG002 - a `Motion`
        """The pose, which is the same at all times."""
        return self.pose

    def poses(self, times_s: Float[np.ndarray, " count"]) -> Float64[np.ndarray, "count 4"]:
        """World x, y, z [m] and yaw [rad] at each time."""
        row = (self.pose.x, self.pose.y, self.pose.z, self.pose.yaw)
        return np.tile(np.array(row, dtype=np.float64), (len(times_s), 1))


def _rows(
    places: Float64[np.ndarray, "count 2"],
    heights: Float64[np.ndarray, " count"],
    yaws: Float64[np.ndarray, " count"],
) -> Float64[np.ndarray, "count 4"]:
    wrapped = (yaws + np.pi) % (2 * np.pi) - np.pi
    return np.concatenate((places, heights[:, None], wrapped[:, None]), axis=1)


def _pose(rows: Float64[np.ndarray, "1 4"]) -> Pose:
    x, y, z, yaw = rows[0].tolist()
    return Pose(x=x, y=y, z=z, yaw=yaw)

"""Motions of the ego, vehicles and people: smooth, exact and defined at all times."""

from dataclasses import astuple, dataclass, replace
from typing import Final, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Float64

from sightline.simulation.arrays import AnyValues
from sightline.simulation.scene import Motion, Pose
from sightline.simulation.streets.ground import surface_height
from sightline.simulation.streets.layout import Road, Terrain

# Fitted to planes through the road in KITTI's sweeps and to the heights of its labels.
_LEAN: Final = 0.003
_LEAN_FREEDOM: Final = 2.0
"""Scale [rad] and degrees of freedom of Student's t: mostly small, sometimes a degree."""
_LARGEST_LEAN: Final = 0.03
_LARGEST_SWING: Final = 0.002  # maximum swing of a body on its springs [rad]


@runtime_checkable
class Track(Protocol):
    """Motion with vectorised poses."""

    def at(self, time_s: float) -> Pose:
        """Compute the pose at a time [s]."""
        return _pose(self.poses(np.array([time_s])))

    def poses(self, times_s: AnyValues) -> Float64[np.ndarray, "count 6"]:
        """Compute world x, y, z [m], yaw, pitch and roll [rad] at each time."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Travel:
    """Distance travelled as a function of time.

    Vehicles of one lane share a travel, so that the gaps between them never change.
    """

    speed_mps: float  # mean speed
    sway_mps: float = 0.0
    """Amplitude of the speed's changes; less than the mean, so that nothing moves backwards."""
    period_s: float = 12.0
    phase: float = 0.0

    def distance(self, times_s: Float[np.ndarray, "*shape"]) -> Float64[np.ndarray, "*shape"]:
        """Compute the distance [m] since time 0."""
        rate = 2 * np.pi / self.period_s
        waves = np.sin(rate * np.asarray(times_s) + self.phase) - np.sin(self.phase)
        times = np.asarray(times_s, np.float64)
        return np.asarray(self.speed_mps * times + self.sway_mps / rate * waves)


STANDING = Travel(speed_mps=0.0)


@dataclass(frozen=True, kw_only=True, slots=True)
class AlongRoad(Track):
    """Motion along a road at a constant distance from its centre line."""

    terrain: Terrain
    road: Road
    station: float  # station at time 0
    offset: float
    direction: int  # 1 along the line, -1 against it
    travel: Travel
    turn: float = 0.0
    """Heading relative to the direction of travel [rad], for example of a car parked askew."""
    wheels_lw: tuple[float, float] = (0.0, 0.0)
    """Wheelbase and track width [m], which define the tilt with the ground."""

    def poses(self, times_s: AnyValues) -> Float64[np.ndarray, "count 6"]:
        """Compute world x, y, z [m], yaw, pitch and roll [rad] at each time."""
        stations = self.station + self.direction * self.travel.distance(times_s)
        places = self.road.line.place(stations, np.array(self.offset))
        turn = (0.0 if self.direction > 0 else np.pi) + self.turn
        yaws = self.road.line.yaw(stations) + turn
        # Contact points of the wheels: front and rear, left and right.
        cos, sin = np.cos(turn), np.sin(turn)
        ahead = self.wheels_lw[0] / 2 * np.array([[1.0, 1.0], [-1.0, -1.0]])
        aside = self.wheels_lw[1] / 2 * np.array([[1.0, -1.0], [1.0, -1.0]])
        wheels = surface_height(
            self.terrain,
            self.road,
            stations[:, None, None] + cos * ahead - sin * aside,
            self.offset + sin * ahead + cos * aside,
        )
        return _rows(places, wheels, yaws, self.wheels_lw)


@dataclass(frozen=True, kw_only=True, slots=True)
class AcrossRoad(Track):
    """Walk straight across a road and beyond it, over the kerbs."""

    terrain: Terrain
    road: Road
    station: float
    offset: float  # offset at time 0
    direction: int  # 1 to the left of the road, -1 to its right
    travel: Travel

    def poses(self, times_s: AnyValues) -> Float64[np.ndarray, "count 6"]:
        """Compute world x, y, z [m], yaw, pitch and roll [rad] at each time."""
        offsets = self.offset + self.direction * self.travel.distance(times_s)
        station = np.array(self.station)
        places = self.road.line.place(station, offsets)
        heights = surface_height(self.terrain, self.road, station, offsets)
        yaw = float(self.road.line.yaw(station)) + self.direction * np.pi / 2
        return _rows(places, heights[:, None, None], np.full(len(offsets), yaw))


@dataclass(frozen=True, kw_only=True, slots=True)
class Still(Track):
    """Constant pose."""

    pose: Pose

    def poses(self, times_s: AnyValues) -> Float64[np.ndarray, "count 6"]:
        """Return world x, y, z [m], yaw, pitch and roll [rad] at each time."""
        return np.tile(np.array(astuple(self.pose), dtype=np.float64), (len(times_s), 1))


@dataclass(frozen=True, kw_only=True, slots=True)
class Rocking:
    """Vehicle body on springs, which leans with its load, brakes and motion."""

    track: Motion
    lean: tuple[float, float]  # constant part of pitch and roll [rad]
    swing: tuple[float, float]  # amplitude of pitch and roll [rad] around it
    period_s: tuple[float, float]
    phases: tuple[float, float]

    def at(self, time_s: float) -> Pose:
        """Compute the pose at a time [s]."""
        pose = self.track.at(time_s)
        pitch, roll = (
            lean + swing * float(np.sin(2 * np.pi * time_s / period + phase))
            for lean, swing, period, phase in zip(
                self.lean, self.swing, self.period_s, self.phases, strict=True
            )
        )
        return replace(pose, pitch=pose.pitch + pitch, roll=pose.roll + roll)


def draw_rocking(rng: np.random.Generator, track: Motion) -> Rocking:
    """Draw a body on springs with the tilts of KITTI's sensors."""
    lean = _LEAN * rng.standard_t(_LEAN_FREEDOM, 2)
    pitch, roll = np.clip(lean, -_LARGEST_LEAN, _LARGEST_LEAN).tolist()
    pitch_swing, roll_swing = rng.uniform(0.0, _LARGEST_SWING, 2).tolist()
    pitch_s, roll_s = rng.uniform(0.7, 1.4, 2).tolist()
    pitch_phase, roll_phase = rng.uniform(0, 2 * np.pi, 2).tolist()
    return Rocking(
        track=track,
        lean=(pitch, roll),
        swing=(pitch_swing, roll_swing),
        period_s=(pitch_s, roll_s),
        phases=(pitch_phase, roll_phase),
    )


def on_wheels(track: Track, terrain: Terrain, wheels_lw: tuple[float, float]) -> Track:
    """Tilt a track with the ground, given wheelbase and track width [m]."""
    if isinstance(track, AlongRoad):
        return replace(track, wheels_lw=wheels_lw)
    if not isinstance(track, Still):
        return track
    pose = track.pose
    cos, sin = np.cos(pose.yaw), np.sin(pose.yaw)
    axes = np.array([[cos, sin], [-sin, cos]]) * (np.array(wheels_lw)[:, None] / 2)
    corners = np.array([[[1.0, 1.0], [1.0, -1.0]], [[-1.0, 1.0], [-1.0, -1.0]]]) @ axes
    middle = np.array([pose.x, pose.y])
    bumps = terrain.height(middle + corners) - terrain.height(middle)
    row = _rows(middle[None], pose.z + bumps[None], np.array([pose.yaw]), wheels_lw)
    return Still(pose=_pose(row))


def _rows(
    places: Float64[np.ndarray, "count 2"],
    heights: Float64[np.ndarray, "count rows columns"],
    yaws: Float64[np.ndarray, " count"],
    wheels_lw: tuple[float, float] = (0.0, 0.0),
) -> Float64[np.ndarray, "count 6"]:
    """Build poses from heights: one, or one per wheel by row, left and right."""
    wrapped = (yaws + np.pi) % (2 * np.pi) - np.pi
    length, width = wheels_lw
    rows, columns = heights.mean(axis=2), heights.mean(axis=1)
    upright = np.zeros(len(yaws))
    pitch = np.arctan2(rows[:, -1] - rows[:, 0], length) if length else upright
    roll = np.arctan2(columns[:, 0] - columns[:, -1], width) if width else upright
    return np.column_stack((places, heights.mean(axis=(1, 2)), wrapped, pitch, roll))


def _pose(rows: Float64[np.ndarray, "1 6"]) -> Pose:
    x, y, z, yaw, pitch, roll = rows[0].tolist()
    return Pose(x=x, y=y, z=z, yaw=yaw, pitch=pitch, roll=roll)

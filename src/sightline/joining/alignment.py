"""Rotation of the LiDAR against its calibration, measured over frames for joining."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields
from functools import reduce
from operator import add
from typing import Any, Final, NamedTuple

import numpy as np
from jaxtyping import Float64

from sightline.data.datasets.sample_dataset import SampleDataset
from sightline.geometry.ranges import check_range
from sightline.health.monitor import HealthMonitor
from sightline.health.tilt_error import estimate_tilt
from sightline.health.yaw_error import LARGEST_DEG, EdgeMatch, estimate_yaw
from sightline.structures.lidar_turn import LidarTurn
from sightline.structures.sample import CameraLidarSample

NUM_ALIGNED_FRAMES: Final = 15
"""Number of frames, evenly spread over a recording, by which its rotation is measured."""
MIN_FRAMES: Final = 5
"""Minimum number of frames with edges: fewer tell nothing sure about the rotation."""

_GROUPS: Final = 10  # of frames, each left out once for the noise
_NOISES: Final = 3.0  # by which an angle must exceed its noise
_LARGEST_DEG: Final = (LARGEST_DEG, 3.0, 1.4)  # yaw, pitch, roll: search ends little beyond
_DECIMALS: Final = 2  # of degrees: an angle is undone as it is told, on every machine


class _Angles(NamedTuple):
    """Angles [degrees]."""

    yaw: float
    pitch: float
    roll: float


@dataclass(frozen=True, kw_only=True, slots=True)
class AlignmentConfig:
    """Biases of the estimates on sound data, and the least angles that are undone."""

    yaw_bias_deg: float = -0.13
    """Yaw measured on sound frames, by which all are corrected: KITTI's, in every list of real
    frames. For other recordings give what `measure_angles` finds while the mount is sound."""
    pitch_bias_deg: float = 0.12
    """Pitch likewise, of KITTI and of simulated frames."""
    roll_bias_deg: float = 0.0
    """Roll likewise."""
    min_yaw_deg: float = 0.25
    """Yaw from which it is undone; sound groups of five frames deviate by up to 0.13."""
    min_pitch_deg: float = 0.35
    """Pitch likewise; the estimate's steps are 0.16."""
    min_roll_deg: float = 0.6
    """Roll likewise; the estimate's steps are 0.4."""
    max_yaw_spread_deg: float = 0.4
    """Interquartile range of the frames' own yaws, above which they do not agree; 0.07 if sound."""

    def __post_init__(self) -> None:
        """Check the angles."""
        for each in fields(self):
            lowest = 0 if each.name.startswith(("min_", "max_")) else -180
            check_range(each.name, getattr(self, each.name), lowest, 180)


class Measured(NamedTuple):
    """Rotation measured over frames, biases included."""

    turn: LidarTurn
    noise_deg: tuple[float, float, float]
    """Standard error of yaw, pitch and roll, by leaving out a tenth of the frames in turns."""
    yaw_spread_deg: float
    """Interquartile range of the frames' own yaws."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Alignment:
    """State of the LiDAR's mount in a recording, as its frames tell."""

    turn: LidarTurn = field(default_factory=LidarTurn)
    """Rotation to undo in each frame; 0 for angles not surely above their noise."""
    by_boxes: bool = False
    """Alignment of each frame by its own boxes (`turn_by_boxes`), because the frames disagree."""
    late: bool = False
    """Delay of the sweeps behind the images (`measure_advance`), which shifts their boxes."""

    def __bool__(self) -> bool:
        """Tell whether there is anything to undo."""
        return self.by_boxes or self.late or bool(self.turn)

    def __str__(self) -> str:
        """Describe it for the user."""
        if self.late:
            return (
                "the sweeps are late behind the images: boxes of objects in the image are the "
                "image detector's alone; correct the time stamps"
            )
        if self.by_boxes:
            return (
                "the frames disagree on the LiDAR's rotation in its mount: each is aligned by the "
                "boxes that both detectors found"
            )
        if not self:
            return "nothing to align: the LiDAR fits the calibration, as far as it was measured"
        angles = ", ".join(
            f"{name.removesuffix('_deg')} {angle:g} deg"
            for name, angle in self.turn.to_json().items()
            if angle
        )
        return (
            f"the LiDAR is turned in its mount against the calibration ({angles}): undone; correct "
            "the calibration"
        )

    def to_json(self) -> dict[str, Any]:
        """List the angles [degrees], or the state that is on."""
        if self.late:
            return {"late": True}
        return {"by_boxes": True} if self.by_boxes else self.turn.to_json()

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> "Alignment":
        """Read what `to_json` made.

        Raises:
            TypeError: There are other entries.
            ValueError: An angle is not finite.
        """
        if content in ({"by_boxes": True}, {"late": True}):
            return cls(**content)
        return cls(turn=LidarTurn(**{name: float(angle) for name, angle in content.items()}))


def measure_angles(samples: Iterable[CameraLidarSample]) -> Measured | None:
    """Measure the rotation of the LiDAR by edges of image and depth; about 40 ms a frame.

    Returns:
        The rotation; None: in fewer than `MIN_FRAMES` frames both sensors show edges.
    """
    monitor = HealthMonitor()
    found = [monitor.judge(sample)[1] for sample in samples]
    matches = [match for match in found if match is not None]
    if len(matches) < MIN_FRAMES:
        return None
    angles = _angles(reduce(add, matches))
    noise = _noise(matches)
    lower, upper = np.quantile([estimate_yaw(match).yaw_deg for match in matches], (0.25, 0.75))
    return Measured(
        turn=LidarTurn(yaw_deg=angles.yaw, pitch_deg=angles.pitch, roll_deg=angles.roll),
        noise_deg=(float(noise[0]), float(noise[1]), float(noise[2])),
        yaw_spread_deg=float(upper - lower),
    )


def measure_alignment(
    samples: Iterable[CameraLidarSample], config: AlignmentConfig = AlignmentConfig()
) -> Alignment | None:
    """Measure the rotation of the LiDAR less its bias, and keep the angles that are sure.

    Args:
        samples: Frames of one recording; more than `NUM_ALIGNED_FRAMES` are hardly any better.
        config: Biases and limits.

    Returns:
        The state; None: fewer than `MIN_FRAMES` show edges, so nothing is known.
    """
    measured = measure_angles(samples)
    if measured is None:
        return None
    if measured.yaw_spread_deg > config.max_yaw_spread_deg:
        return Alignment(by_boxes=True)
    turn = measured.turn
    less_bias = (
        turn.yaw_deg - config.yaw_bias_deg,
        turn.pitch_deg - config.pitch_bias_deg,
        turn.roll_deg - config.roll_bias_deg,
    )
    limits = (config.min_yaw_deg, config.min_pitch_deg, config.min_roll_deg)
    yaw_deg, pitch_deg, roll_deg = (
        round(angle, _DECIMALS) if max(limit, _NOISES * noise) < abs(angle) <= largest else 0.0
        for angle, limit, noise, largest in zip(
            less_bias, limits, measured.noise_deg, _LARGEST_DEG, strict=True
        )
    )
    return Alignment(turn=LidarTurn(yaw_deg=yaw_deg, pitch_deg=pitch_deg, roll_deg=roll_deg))


def spread_samples(
    samples: Sequence[CameraLidarSample] | SampleDataset,
) -> Iterator[CameraLidarSample]:
    """Yield up to `NUM_ALIGNED_FRAMES` frames, evenly spread; unreadable ones are left out."""
    for index in evenly_spread(len(samples)):
        with suppress(ValueError):
            yield samples[index]


def evenly_spread(num_frames: int) -> list[int]:
    """Choose the indices of at most `NUM_ALIGNED_FRAMES` frames, evenly spread."""
    places = np.linspace(0, num_frames - 1, min(num_frames, NUM_ALIGNED_FRAMES))
    return [int(place) for place in places.round()]


def _angles(match: EdgeMatch) -> _Angles:
    tilt = estimate_tilt(match.tops)
    return _Angles(estimate_yaw(match).yaw_deg, tilt.pitch_deg, tilt.roll_deg)


def _noise(matches: Sequence[EdgeMatch]) -> Float64[np.ndarray, "3"]:
    """Estimate the standard errors of the angles by leaving out groups of the frames."""
    count = min(_GROUPS, len(matches))
    left = [
        _angles(reduce(add, [match for i, match in enumerate(matches) if i % count != group]))
        for group in range(count)
    ]
    values = np.array(left)
    return np.asarray(np.sqrt((count - 1) / count * ((values - values.mean(0)) ** 2).sum(0)))

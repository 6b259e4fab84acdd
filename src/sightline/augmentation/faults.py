"""Sensor faults for training, robustness tables and pages."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from sightline.augmentation.sample_changes import (
    add_outliers,
    drop_camera,
    rotate_extrinsics,
    thin_rings,
)
from sightline.geometry.wrong_types import named_arguments, named_fields
from sightline.structures.lidar_turn import LidarTurn
from sightline.structures.sample import CameraLidarSample

_END_OF_NAME = 256  # not a byte


class Fault(ABC):
    """Sensor fault of some severity; `str` is its name in tables.

    A fault is a frozen dataclass of plain numbers: `dataclasses.asdict` records it.
    """

    @abstractmethod
    def __str__(self) -> str:
        """Name of the fault."""

    @abstractmethod
    def __call__(self, sample: CameraLidarSample, rng: np.random.Generator) -> CameraLidarSample:
        """Apply the fault to a sample; the truth stays unchanged.

        Args:
            sample: Sample of sound sensors.
            rng: Generator of all random numbers; some faults draw none.

        Raises:
            ValueError: The sample lacks the faulty part.
        """


@named_fields
@dataclass(frozen=True, kw_only=True, slots=True)
class TurnedLidar(LidarTurn, Fault):
    """LiDAR rotated in its mount without a change of the calibration."""

    def __str__(self) -> str:
        """List the angles that are not 0."""
        named = (("yaw", self.yaw_deg), ("pitch", self.pitch_deg), ("roll", self.roll_deg))
        angles = [f"{name} {angle_deg:g} deg" for name, angle_deg in named if angle_deg]
        return ", ".join(angles) or "yaw 0 deg"

    def __call__(self, sample: CameraLidarSample, rng: np.random.Generator) -> CameraLidarSample:
        """Rotate the LiDAR; see `rotate_extrinsics`."""
        del rng
        return rotate_extrinsics(
            sample, yaw_deg=self.yaw_deg, pitch_deg=self.pitch_deg, roll_deg=self.roll_deg
        )


@named_fields
@dataclass(frozen=True, kw_only=True, slots=True)
class FalseEchoes(Fault):
    """LiDAR with a share of false ranges."""

    share: float
    """Share of the returns."""

    def __post_init__(self) -> None:
        """Check the range."""
        if not 0 <= self.share <= 1:
            raise ValueError(f"share must be between 0 and 1, got {self.share}")

    def __str__(self) -> str:
        """Show the share."""
        return f"{100 * self.share:g} % outliers"

    def __call__(self, sample: CameraLidarSample, rng: np.random.Generator) -> CameraLidarSample:
        """Add false ranges; see `add_outliers`."""
        return add_outliers(sample, share=self.share, rng=rng)


@named_fields
@dataclass(frozen=True, kw_only=True, slots=True)
class FewerRings(Fault):
    """LiDAR with fewer beams: every `keep_every`th ring from ring `first` on."""

    keep_every: int
    first: int = 0

    def __post_init__(self) -> None:
        """Check that a ring is left."""
        if not 0 <= self.first < self.keep_every:
            raise ValueError(
                f"first must be at least 0 and below keep_every {self.keep_every}, got {self.first}"
            )

    def __str__(self) -> str:
        """Show the share of the rings, not the first ring."""
        return f"1 ring of {self.keep_every}"

    def __call__(self, sample: CameraLidarSample, rng: np.random.Generator) -> CameraLidarSample:
        """Remove rings; see `thin_rings`."""
        del rng
        return thin_rings(sample, self.keep_every, self.first)


@dataclass(frozen=True, kw_only=True, slots=True)
class NoCamera(Fault):
    """Camera that delivers nothing."""

    def __str__(self) -> str:
        """Name of the fault."""
        return "no camera"

    def __call__(self, sample: CameraLidarSample, rng: np.random.Generator) -> CameraLidarSample:
        """Remove the image; see `drop_camera`."""
        del rng
        return drop_camera(sample)


@named_arguments
def fault_rng(sample: CameraLidarSample, seed: int = 0, kind: str = "") -> np.random.Generator:
    """Create a generator that depends only on the arguments: every method gets the same faults.

    Args:
        sample: Sample whose name is used.
        seed: Seed, not negative.
        kind: Kind of fault, for independent draws of several kinds.
    """
    names = [*sample.sample_id.encode()]
    if kind:
        names += [_END_OF_NAME, *kind.encode()]
    return np.random.default_rng([seed, *names])


@named_arguments
def draw_turned_lidar(error_deg: float, rng: np.random.Generator) -> TurnedLidar:
    """Draw a normal mounting error: deviation `error_deg` in yaw, half in the others."""
    yaw_deg, pitch_deg, roll_deg = map(
        float, error_deg * np.array((1, 0.5, 0.5)) * rng.normal(size=3)
    )
    return TurnedLidar(yaw_deg=yaw_deg, pitch_deg=pitch_deg, roll_deg=roll_deg)

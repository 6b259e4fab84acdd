"""Health of sensors, estimated from their data."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

ALARM_SCORE = 0.5
"""Score below which a sensor is not trusted; the limits accept a small share of such sound
frames."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Health:
    """Health of one sensor, or of the alignment of two sensors.

    Raises:
        ValueError: The score is not in [0, 1].
    """

    score: float
    """1: no fault; `ALARM_SCORE`: as bad as only few sound frames; 0: the sensor delivered
    nothing."""
    worst_check: str
    """Check with the lowest score: a field of the checks, or `absent`."""

    def __post_init__(self) -> None:
        """Check the range."""
        if not 0 <= self.score <= 1:
            raise ValueError(f"a score of health must be in [0, 1], got {self.score}")

    @property
    def is_alarm(self) -> bool:
        """Whether the sensor is not to be trusted, by this frame alone."""
        return self.score < ALARM_SCORE


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SampleHealth:
    """Health of the sensors of one sample, and their faulty regions."""

    sample_id: str
    camera: Health
    lidar: Health
    alignment: Health | None
    """Health of the alignment; None: unknown, as a sensor is absent or bad, or there are no
    edges."""
    yaw_deg: float | None
    """Rotation of the LiDAR about z that best aligns the edges of both; None: unknown."""
    camera_regions: Bool[np.ndarray, "rows columns"]
    """Mask of the image blocks, on a regular grid, that show nothing."""
    lidar_regions: Bool[np.ndarray, "cell_rows cell_columns"]
    """Mask of the cells ahead without points, highest and leftmost first; see `health.regions`."""
    blind_sectors: Bool[np.ndarray, " num_sectors"]
    """Mask of the sectors of a full turn without points, counter-clockwise from behind; all False
    if the sweep is cropped to the camera's view."""

    @property
    def worst_score(self) -> float:
        """Lowest of the known scores."""
        known = [each.score for each in (self.camera, self.lidar, self.alignment) if each]
        return min(known)


@dataclass(frozen=True, kw_only=True, slots=True)
class Alarms:
    """Active alarms."""

    camera: bool
    lidar: bool
    alignment: bool


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FrameHealth:
    """Health of one frame of a drive."""

    health: SampleHealth
    alarms: Alarms
    """Alarms after this frame."""

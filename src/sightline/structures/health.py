"""How well sensors work, as told from what they delivered."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

ALARM_SCORE = 0.5
"""Below it a sensor is not to be trusted; of sound frames so few are that the limits allow for."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Health:
    """Of one sensor, or of how two of them lie to each other.

    Raises:
        ValueError: The score is not in [0, 1].
    """

    score: float
    """1: nothing is wrong; `ALARM_SCORE`: as bad as few sound frames are; 0: it delivered
    nothing."""
    worst_check: str
    """The check that says the worst: a field of the checks, or `absent`."""

    def __post_init__(self) -> None:
        """Checks the range."""
        if not 0 <= self.score <= 1:
            raise ValueError(f"a score of health must be in [0, 1], got {self.score}")

    @property
    def is_alarm(self) -> bool:
        """Whether this one look says that it is not to be trusted."""
        return self.score < ALARM_SCORE


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SampleHealth:
    """Of the sensors of one sample, and where they are bad."""

    sample_id: str
    camera: Health
    lidar: Health
    alignment: Health | None
    """None where it cannot be told: a sensor is absent or bad, or there are no edges."""
    yaw_deg: float | None
    """The LiDAR's turn about z that best joins the edges of both; None likewise."""
    camera_regions: Bool[np.ndarray, "rows columns"]
    """Blocks of the image, evenly spread over it, that show nothing."""
    lidar_regions: Bool[np.ndarray, "cell_rows cell_columns"]
    """Cells ahead without points, highest and leftmost first; see `health.regions`."""
    blind_sectors: Bool[np.ndarray, " num_sectors"]
    """Sectors of a whole turn without points, counter-clockwise from behind; none of a sweep that
    is cut to the camera's view."""

    @property
    def worst_score(self) -> float:
        """The least score of what can be told."""
        known = [each.score for each in (self.camera, self.lidar, self.alignment) if each]
        return min(known)


@dataclass(frozen=True, kw_only=True, slots=True)
class Alarms:
    """Which alarms are on."""

    camera: bool
    lidar: bool
    alignment: bool


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FrameHealth:
    """One frame of a drive."""

    health: SampleHealth
    alarms: Alarms
    """After this frame."""

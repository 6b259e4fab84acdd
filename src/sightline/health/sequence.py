"""Health of a drive's sensors, with alarms that have hysteresis."""

from dataclasses import dataclass

from sightline.geometry.arguments import wrong_type
from sightline.geometry.wrong_types import named_fields
from sightline.health.monitor import HealthMonitor
from sightline.health.yaw_error import EdgeMatch
from sightline.structures.health import ALARM_SCORE, Alarms, FrameHealth, Health
from sightline.structures.sample import CameraLidarSample


@named_fields
@dataclass(frozen=True, kw_only=True, slots=True)
class HysteresisConfig:
    """Settings for raising and clearing alarms.

    Raises:
        ValueError: A number is out of range.
    """

    raise_after: int = 2
    """Consecutive frames below `ALARM_SCORE`."""
    at_once_score: float = 0.01
    """Maximum score at which a single frame raises the alarm: a sensor is absent, black or
    empty."""
    clear_after: int = 5
    """Consecutive frames at `clear_score` or more."""
    clear_score: float = 0.55
    """Minimum score to clear; above `ALARM_SCORE`, so that an alarm does not flicker around one
    score."""
    memory: float = 0.8
    """Weight of earlier frames' edges in the alignment, relative to the latest: 0.8 averages over
    about five frames. Frames without matching edges do not count."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        if self.raise_after < 1 or self.clear_after < 1:
            raise ValueError(
                f"alarms are raised and cleared after at least 1 frame, got {self.raise_after} and "
                f"{self.clear_after}"
            )
        if not ALARM_SCORE <= self.clear_score <= 1:
            raise ValueError(f"clear_score must be from {ALARM_SCORE} to 1, got {self.clear_score}")
        if not 0 <= self.at_once_score <= ALARM_SCORE:
            raise ValueError(
                f"at_once_score must be from 0 to {ALARM_SCORE}, got {self.at_once_score}"
            )
        if not 0 <= self.memory < 1:
            raise ValueError(f"memory must be at least 0 and below 1, got {self.memory}")


class Alarm:
    """Alarm with hysteresis."""

    def __init__(self, config: HysteresisConfig) -> None:
        """Start without an alarm."""
        self.config = config
        self.is_on = False
        self._num_consecutive = 0

    def update(self, health: Health | None) -> None:
        """Update with the next frame's health, None if it is unknown."""
        if health is None:
            self._num_consecutive = 0
            return
        config = self.config
        if not self.is_on and health.score <= config.at_once_score:
            self.is_on, self._num_consecutive = True, 0
            return
        contradicts = health.score >= config.clear_score if self.is_on else health.is_alarm
        self._num_consecutive = self._num_consecutive + 1 if contradicts else 0
        required = config.clear_after if self.is_on else config.raise_after
        if self._num_consecutive >= required:
            self.is_on, self._num_consecutive = not self.is_on, 0


class DriveMonitor:
    """Health monitor for the frames of a drive, in order.

    Camera and LiDAR are judged by each frame, the alignment by the edges of the last frames
    together: a single frame can be misleading.
    """

    def __init__(
        self, monitor: HealthMonitor | None = None, config: HysteresisConfig | None = None
    ) -> None:
        """Start a drive.

        Args:
            monitor: The monitor. None: one with the limits included in Sightline.
            config: Settings of the alarms.

        Raises:
            TypeError: `monitor` is no monitor, or `config` no settings.
        """
        if not isinstance(monitor, HealthMonitor | None):
            raise wrong_type("monitor", monitor, "HealthMonitor; make one by HealthMonitor(limits)")
        if not isinstance(config, HysteresisConfig | None):
            raise wrong_type("config", config, "HysteresisConfig")
        self.monitor = monitor or HealthMonitor()
        self.config = config or HysteresisConfig()
        self._alarms = tuple(Alarm(self.config) for _ in range(3))
        self._match: EdgeMatch | None = None

    @property
    def alarms(self) -> Alarms:
        """Active alarms after the last frame."""
        camera, lidar, alignment = (alarm.is_on for alarm in self._alarms)
        return Alarms(camera=camera, lidar=lidar, alignment=alignment)

    def __call__(self, sample: CameraLidarSample) -> FrameHealth:
        """Judge the drive's next frame."""
        earlier = self._match and self._match.faded(self.config.memory)
        health, match = self.monitor.judge(sample, earlier)
        self._match = match or self._match
        judged = (health.camera, health.lidar, health.alignment)
        for alarm, each in zip(self._alarms, judged, strict=True):
            alarm.update(each)
        return FrameHealth(health=health, alarms=self.alarms)

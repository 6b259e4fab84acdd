"""What the monitor says of a drive: as JSON and as a table."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool

from sightline.structures.health import FrameHealth, Health

if TYPE_CHECKING:
    from rich.table import Table


_NO_NOISE = ("muddy", "still")  # checks that tell what covers a lens by the noise that is lacking


@dataclass(frozen=True, kw_only=True, slots=True)
class HealthReport:
    """The frames of a drive in their order."""

    frames: tuple[FrameHealth, ...]

    @property
    def is_short_of_rings(self) -> bool:
        """Whether all sweeps are bad by their number of rings, as those of fewer beams are."""
        sweeps = [frame.health.lidar for frame in self.frames]
        there = [each for each in sweeps if each.worst_check != "absent"]
        short = [each for each in there if each.is_alarm and each.worst_check == "ringless"]
        return bool(there) and short == there

    @property
    def is_short_of_noise(self) -> bool:
        """Whether most images are bad by a lack of noise, as those that JPEG compresses are."""
        images = [frame.health.camera for frame in self.frames]
        there = [each for each in images if each.worst_check != "absent"]
        still = [each for each in there if each.is_alarm and each.worst_check in _NO_NOISE]
        return 2 * len(still) > len(there)

    def to_json(self) -> dict[str, Any]:
        """The report as its file has it."""
        return {"frames": [_frame_json(frame) for frame in self.frames]}

    def table(self) -> "Table":
        """One row per frame: scores, the worst check of what is bad, alarms that are on."""
        from rich.box import SIMPLE_HEAD
        from rich.table import Table
        from rich.text import Text

        count = len(self.frames)
        title = f"health of sensors, {count:,} frame{'s' if count != 1 else ''}"
        table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
        table.add_column("frame", no_wrap=True)
        for name in ("camera", "LiDAR", "alignment", "yaw"):
            table.add_column(name, justify="right", no_wrap=True)
        table.add_column("worst", no_wrap=True)
        table.add_column("alarms")
        for frame in self.frames:
            health, alarms = frame.health, frame.alarms
            named = {"camera": alarms.camera, "LiDAR": alarms.lidar, "alignment": alarms.alignment}
            judged = (health.camera, health.lidar, health.alignment)
            worst = min((each for each in judged if each), key=lambda each: each.score)
            table.add_row(
                Text(health.sample_id),  # a name may hold brackets, which are no markup
                *map(_score, judged),
                "-" if health.yaw_deg is None else f"{health.yaw_deg:+.2f}",
                worst.worst_check if worst.is_alarm else "",
                ", ".join(name for name, is_on in named.items() if is_on),
            )
        return table


def _frame_json(frame: FrameHealth) -> dict[str, Any]:
    health, alarms = frame.health, frame.alarms
    return {
        "frame": health.sample_id,
        "camera": _health_json(health.camera),
        "lidar": _health_json(health.lidar),
        "alignment": health.alignment and _health_json(health.alignment),
        "yaw_deg": health.yaw_deg,
        "alarms": {
            "camera": alarms.camera,
            "lidar": alarms.lidar,
            "alignment": alarms.alignment,
        },
        "camera_regions": _regions_json(health.camera_regions),
        "lidar_regions": _regions_json(health.lidar_regions),
        "blind_sectors": np.flatnonzero(health.blind_sectors).tolist(),
    }


def _health_json(health: Health) -> dict[str, Any]:
    return {"score": health.score, "worst_check": health.worst_check}


def _regions_json(regions: Bool[np.ndarray, "rows columns"]) -> dict[str, Any]:
    return {"shape": list(regions.shape), "bad": np.argwhere(regions).tolist()}


def _score(health: Health | None) -> str:
    return "-" if health is None else f"{health.score:.2f}"

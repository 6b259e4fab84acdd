"""Health report of a drive, as JSON and as a table, and the meaning of each check."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from jaxtyping import Bool

from sightline.data.formats.lidar_origin import vehicle_frame_doubt
from sightline.geometry.kitti_mount import KITTI_LIDAR_HEIGHT_M
from sightline.structures.health import FrameHealth, Health
from sightline.structures.sample import CameraLidarSample

if TYPE_CHECKING:
    from rich.table import Table

CHECK_MEANINGS: Final = {
    "absent": "no data",
    "dark": "the image is too dark",
    "bright": "no dark pixels: haze, stray light or overexposure",
    "faint": "little contrast",
    "white": "many saturated pixels",
    "covered": "black areas without texture",
    "textureless": "areas without texture",
    "lifted": "blinding light: contrast, but no dark pixels",
    "still": "areas without the sensor's noise: something covers the view",
    "muddy": "dim spots without the sensor's noise: dirt on the lens",
    "blurred": "fine detail is missing",
    "noisy": "too much image noise",
    "speckled": "single pixels differ from their neighbours",
    "blocky": "block edges of JPEG compression",
    "sparse": "too few points",
    "ringless": "too few beams",
    "gappy": "single returns along the beams are missing",
    "holes": "areas below the horizon without points",
    "narrow": "the horizontal field of view is too small",
    "rough": "noisy ranges",
    "spiky": "single returns in front of or behind their neighbours",
    "stray": "returns off the ray of their laser",
    "jagged": "uneven azimuth steps",
    "cluttered": "returns close to the sensor: fog, rain or snow",
    "short": "no returns far away",
    "faded": "weak far returns: fog",
    "blind": "sectors of the turn without points",
    "turned": "the LiDAR is rotated about z against the calibration",
    "mismatched": "image and LiDAR edges match better at another angle",
    "tilted": "the LiDAR is pitched or rolled against the calibration",
}
"""Meaning by name of the check: the fields of the three kinds of checks, and `absent`."""

_FITTED_SIZE: Final = (375, 1242)
"""Height, width [px] of the images that the included limits were fitted on, simulated as KITTI's:
they show 14 degrees above the horizon."""
_OTHER_SIZE: Final = 1.1
"""Ratio of heights or widths from which images show another part of the street; images of
352 x 1216 do not."""
_EXPECTED_BAD_SHARE: Final = 0.05  # of sound frames of the fitted size, with room for few frames


def doubts(
    frames: Sequence[FrameHealth],
    image_size: tuple[int, int] | None = None,
    *,
    has_sweeps: bool = True,
    are_own_limits: bool = False,
) -> tuple[str, ...]:
    """List reasons why the limits may be for other sensors.

    A sensor is bad in most frames, or a camera in some and its images are of another size. A larger
    image shows more of the sky, whose clouds resemble stray light ('lifted') and whose even parts
    resemble a cover ('still').

    Args:
        frames: Judged frames.
        image_size: Height, width [px] of the images. None: not known.
        has_sweeps: Whether the LiDAR's data are sweeps, not sparse depth maps.
        are_own_limits: Whether the limits come from the user's file.
    """
    remedy = (
        "the limits are of other sensors: fit them to clean data of this one by sightline "
        "health-limits"
        if are_own_limits
        else "its scores are meaningless: fit limits to its first frames by --fit-first 30, or to "
        "clean data by sightline health-limits, given as --limits"
    )
    sensors = [("camera", "images"), *[("lidar", "sweeps")] * has_sweeps]
    doubtful = []
    is_camera_doubtful = False
    for name, data_name in sensors:
        judged: list[Health] = [getattr(frame.health, name) for frame in frames]
        delivered = [each for each in judged if each.worst_check != "absent" and each.score > 0]
        worst = Counter(each.worst_check for each in delivered if each.is_alarm)
        if 2 * worst.total() <= len(delivered):
            continue
        is_camera_doubtful |= name == "camera"
        checks = ", ".join(f"'{check}' ({count})" for check, count in worst.most_common(3))
        doubtful.append(
            f"{worst.total()} of {len(delivered)} {data_name} are bad by {checks}; if this is "
            f"normal for your sensor, {remedy}"
        )
    if not is_camera_doubtful:
        doubtful += _doubt_of_size(frames, image_size)
    return tuple(doubtful)


def doubts_of_origin(sample: CameraLidarSample) -> tuple[str, ...]:
    """List the assumption about points in a vehicle's frame; none about points in the LiDAR's."""
    doubt = vehicle_frame_doubt(sample)
    if doubt is None:
        return ()
    return (
        f"{doubt}, so its rings and holes are judged as seen from KITTI's height of a LiDAR, "
        f"{KITTI_LIDAR_HEIGHT_M} m, above the origin; if sound sweeps are bad by that, give them "
        "in the LiDAR's own frame",
    )


def _doubt_of_size(frames: Sequence[FrameHealth], image_size: tuple[int, int] | None) -> list[str]:
    if image_size is None:
        return []
    pairs = list(zip(image_size, _FITTED_SIZE, strict=True))
    if all(1 / _OTHER_SIZE < side / fitted < _OTHER_SIZE for side, fitted in pairs):
        return []
    delivered = [frame.health.camera for frame in frames if frame.health.camera.score > 0]
    worst = Counter(each.worst_check for each in delivered if each.is_alarm)
    if worst.total() <= _EXPECTED_BAD_SHARE * len(delivered):
        return []
    checks = ", ".join(f"'{check}' ({count})" for check, count in worst.most_common(3))
    (height, width), (fitted_height, fitted_width) = image_size, _FITTED_SIZE
    return [
        f"{worst.total()} of {len(delivered)} images are bad by {checks}, but the camera's limits "
        f"were fitted on simulated images of {fitted_height}x{fitted_width} (height x width), and "
        f"these are {height}x{width}: images that show more of the sky have such scores without a "
        "fault; fit limits to sound frames by --fit-first 30, or by sightline health-limits, given "
        "as --limits"
    ]


@dataclass(frozen=True, kw_only=True, slots=True)
class HealthReport:
    """Health of the frames of a drive, in order."""

    frames: tuple[FrameHealth, ...]

    limits: Mapping[str, str] = field(default_factory=dict)
    """Descriptions of the limits of camera and LiDAR."""
    warnings: tuple[str, ...] = ()
    """Reasons to doubt the scores."""

    def to_json(self) -> dict[str, Any]:
        """Convert the report to its file's content."""
        return {
            "limits": dict(self.limits),
            "warnings": list(self.warnings),
            "frames": [_frame_json(frame) for frame in self.frames],
        }

    @property
    def notes(self) -> tuple[str, ...]:
        """List limits and warnings, a line each."""
        limits = [
            f"{sensor} judged by limits: {description}"
            for sensor, description in self.limits.items()
        ]
        return (*limits, *self.warnings)

    def table(self) -> "Table":
        """Make a table of scores, the worst check of bad sensors and active alarms per frame."""
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
                Text(health.sample_id),  # brackets in a name are not markup
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

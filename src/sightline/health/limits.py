"""Limits of sound sensors, fitted on clean data and stored in a small file."""

import json
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from sightline.files.atomic import atomic_write_text
from sightline.files.plain_file import read_bytes
from sightline.files.plain_text import shortened
from sightline.files.problem import FileError
from sightline.health.alignment_checks import AlignmentChecks
from sightline.health.camera_checks import CameraChecks
from sightline.health.lidar_checks import LidarChecks
from sightline.structures.health import Health

Checks = CameraChecks | LidarChecks | AlignmentChecks

FALSE_ALARMS: Final = 0.01
"""Share of sound frames with a score below `ALARM_SCORE`."""
MIN_SCORE: Final = 0.001
"""Minimum score of a sensor with output; lower values have no further meaning."""
SHIPPED: Final = Path(__file__).with_name("limits.json")
"""Limits fitted on simulated frames, which the file describes."""

_SPREAD_QUANTILE = 0.99  # quantile of sound frames at one spread from the median
_OWN_SPREAD_SHARE = 0.1  # share of the minimum spreads, for limits of the fitted sensors alone
_MIN_FRAMES = 100  # minimum for a quantile of one in a hundred
_MAX_BYTES = 2**20


@dataclass(frozen=True, kw_only=True, slots=True)
class CheckRange:
    """Usual range of one check."""

    median: float
    spread: float
    """Distance from the median to the 99 % quantile of sound frames."""

    def excess(self, value: float) -> float:
        """Compute how far a value is above the median, in spreads."""
        return max((value - self.median) / self.spread, 0.0)


@dataclass(frozen=True, kw_only=True, slots=True)
class SensorLimits:
    """Usual ranges of all checks of one sensor."""

    checks: Mapping[str, CheckRange]
    limit: float
    """Largest excess over a frame's checks that all but `FALSE_ALARMS` of the sound frames stay
    below."""

    def judge(self, checks: Checks, *, without: Collection[str] = ()) -> Health:
        """Compute the score 2^-(largest excess / limit) of a frame; 0 if infinite.

        It is at least `MIN_SCORE` if the sensor has output. A check without a value (NaN) is
        ignored.

        Args:
            checks: Checks of a frame.
            without: Names of ignored checks.
        """
        excesses = {
            name: self.checks[name].excess(value)
            for name, value in checks._asdict().items()
            if not math.isnan(value) and name not in without
        }
        worst = max(excesses, key=excesses.__getitem__)
        excess = excesses[worst] / self.limit
        score = 0.0 if math.isinf(excess) else max(2.0**-excess, MIN_SCORE)
        return Health(score=score, worst_check=worst)


@dataclass(frozen=True, kw_only=True, slots=True)
class HealthLimits:
    """Limits of all sensors, with a description of the data that they are fitted on."""

    camera: SensorLimits
    lidar: SensorLimits
    alignment: SensorLimits
    provenance: Mapping[str, str | int]


def fit_limits(
    rows: Sequence[Checks], min_spreads: Checks, *, transfer: bool = False
) -> SensorLimits:
    """Fit limits that one sound frame in a hundred exceeds.

    Each check is measured from its median in spreads; a frame counts by its largest value. The
    limit is the quantile of these over the frames, at least 1, so the rate of false alarms is that
    of all checks together.

    Args:
        rows: The checks of sound frames.
        min_spreads: Minimum spread of each check if `transfer` is set; otherwise a tenth of it is
            the minimum: a check that is nearly constant in so few frames may vary in others.
        transfer: Whether the limits also serve sensors of other makes.

    Raises:
        ValueError: There are too few frames, or a check is infinite or has no values.
    """
    check_enough(len(rows))
    names = rows[0]._fields
    values = np.array(rows, dtype=np.float64)
    for name, column in zip(names, values.T, strict=True):
        measured = column[~np.isnan(column)]
        if not len(measured) or not np.isfinite(measured).all():
            raise ValueError(
                f"limits need frames of sound sensors, but check '{name}' has no value in any "
                "frame, or an infinite one (a sweep without points); give other frames"
            )
    median = np.nanmedian(values, axis=0)
    min_spread = np.array(min_spreads) * (1.0 if transfer else _OWN_SPREAD_SHARE)
    spread = np.maximum(np.nanquantile(values, _SPREAD_QUANTILE, axis=0) - median, min_spread)
    ranges = {
        name: CheckRange(median=float(middle), spread=float(width))
        for name, middle, width in zip(names, median, spread, strict=True)
    }
    largest = np.nanmax(np.maximum((values - median) / spread, 0), axis=1)
    limit = float(np.quantile(largest, 1 - FALSE_ALARMS))
    return SensorLimits(checks=ranges, limit=max(1.0, limit))


def check_enough(num_frames: int) -> None:
    """Check that there are enough clean frames for limits.

    Raises:
        ValueError: There are too few.
    """
    if num_frames < _MIN_FRAMES:
        raise ValueError(
            f"limits need at least {_MIN_FRAMES} clean frames, got {num_frames}: a rate "
            "of 1 % cannot be measured with fewer"
        )


def write_limits(path: Path, limits: HealthLimits) -> None:
    """Write limits as JSON, atomically."""
    sensors = {
        name: {
            "limit": each.limit,
            "checks": {
                check: {"median": check_range.median, "spread": check_range.spread}
                for check, check_range in each.checks.items()
            },
        }
        for name, each in _by_sensor(limits).items()
    }
    content = {"provenance": dict(limits.provenance), **sensors}
    atomic_write_text(path, json.dumps(content, indent=1) + "\n")


def read_limits(path: Path = SHIPPED) -> HealthLimits:
    """Read limits; by default those included in Sightline.

    Raises:
        FileError: The file contains no limits, or limits of other checks.
    """
    remedy = "write limits by `sightline health-limits`"
    data = read_bytes(path, max_bytes=_MAX_BYTES, remedy=remedy)
    try:
        content = json.loads(data)
        return HealthLimits(
            camera=_sensor_limits(content["camera"], CameraChecks._fields),
            lidar=_sensor_limits(content["lidar"], LidarChecks._fields),
            alignment=_sensor_limits(content["alignment"], AlignmentChecks._fields),
            provenance=dict(content["provenance"]),
        )
    except KeyError as error:
        raise FileError(path, f"holds no limits: {error} is not in it", remedy) from error
    except (TypeError, ValueError, RecursionError) as error:
        raise FileError(path, f"holds no limits of these checks ({error})", remedy) from error


def _by_sensor(limits: HealthLimits) -> dict[str, SensorLimits]:
    return {"camera": limits.camera, "lidar": limits.lidar, "alignment": limits.alignment}


def _sensor_limits(content: Mapping[str, Any], names: Sequence[str]) -> SensorLimits:
    if set(content["checks"]) != set(names):
        differing = sorted(set(content["checks"]) ^ set(names))
        raise ValueError(
            f"its checks differ by {shortened(', '.join(differing))}; it may be of another version"
        )
    ranges = {
        name: CheckRange(
            median=_finite(content["checks"][name]["median"]),
            spread=_positive(content["checks"][name]["spread"]),
        )
        for name in names
    }
    return SensorLimits(checks=ranges, limit=_positive(content["limit"]))


def _finite(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"expected a number, got {shortened(str(value))}")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise ValueError("expected a finite number")
    return number


def _positive(value: object) -> float:
    number = _finite(value)
    if number <= 0:
        raise ValueError(f"expected a number above 0, got {number}")
    return number

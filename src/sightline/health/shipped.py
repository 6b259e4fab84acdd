"""Limits included in Sightline, and their selection for the frames of a drive."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np

from sightline.data.datasets.sample_dataset import SampleDataset
from sightline.data.datasets.sample_files import list_sample_files
from sightline.health.camera_checks import CameraChecks, check_camera
from sightline.health.lidar_checks import LidarChecks, check_lidar
from sightline.health.limits import (
    SHIPPED,
    CheckRange,
    Checks,
    HealthLimits,
    SensorLimits,
    read_limits,
)
from sightline.health.monitor import rgb_of
from sightline.health.ring_order import level_by_ring
from sightline.structures.sample import CameraLidarSample

ImageKind = Literal["png", "jpeg"]
"""Format of the images: lossless, or JPEG of quality 75 to 95."""
BEAMS: Final = (64, 32, 16)
"""Numbers of beams with included limits."""

MIN_FIRST_FRAMES: Final = 10
"""Minimum number of frames for limits fitted to the drive itself."""

_NUM_CHECKED_FRAMES = 15  # for choosing the included limits, evenly spread over the drive
_JPEG_SUFFIXES = (".jpg", ".jpeg")
_RINGS_AHEAD = {64: 40.0, 32: 20.0, 16: 12.5}
"""Rings in the checked part of a sweep: of 32 beams 17 (HDL-32E) to 20 (every second one of KITTI's
LiDAR), of 16 beams 10 (every fourth one) to 15 (VLP-16)."""
_MIN_JPEG_BLOCKINESS = 0.045  # median of `blocky`; below 0.035 without compression
_MAX_ALARM_SHARE = 0.2  # of the frames for fitting limits: a sensor may have failed in some
_RING_QUANTILE = 0.8  # quantile over the frames: in some a LiDAR may have failed
_SPREAD_FACTOR = 2.0  # factor by which limits of few frames exceed their range


@dataclass(frozen=True, kw_only=True, slots=True)
class DriveChecks:
    """Checks of some frames of a drive, without frames in which the sensor has no output."""

    camera: tuple[CameraChecks, ...]
    lidar: tuple[LidarChecks, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class ChosenLimits:
    """Limits chosen for a drive, with descriptions."""

    limits: HealthLimits
    camera: str
    """Description of the camera's limits."""
    lidar: str
    """Description of the limits of the LiDAR and the alignment."""
    warnings: tuple[str, ...] = ()


def shipped_limits(images: ImageKind = "png", beams: int = 64) -> HealthLimits:
    """Read limits for an image format and a number of beams; the alignment's depend on the beams.

    Raises:
        ValueError: There are none for this number of beams.
    """
    if beams not in BEAMS:
        raise ValueError(
            f"there are limits for LiDARs of {', '.join(map(str, BEAMS))} beams, got {beams}; "
            "choose the nearest"
        )
    for_camera, for_lidar = (
        read_limits(SHIPPED if name is None else SHIPPED.with_name(f"limits_{name}.json"))
        for name in (None if images == "png" else images, None if beams == 64 else beams)
    )
    return replace(for_lidar, camera=for_camera.camera)


def check_frames(samples: Iterable[CameraLidarSample]) -> DriveChecks:
    """Check all frames with an image, or a sweep, that is not empty."""
    camera: list[CameraChecks] = []
    lidar: list[LidarChecks] = []
    for sample in map(level_by_ring, samples):
        image = rgb_of(sample)
        if image is not None and image.any():
            camera.append(check_camera(image))
        if sample.points is not None:
            lidar.append(check_lidar(sample.points.numpy()))
    whole = (each for each in lidar if np.isfinite(each.sparse))
    return DriveChecks(camera=tuple(camera), lidar=tuple(whole))


def choose_shipped(
    checks: DriveChecks,
    *,
    images: ImageKind | None = None,
    beams: int | None = None,
    are_jpeg_files: bool = False,
) -> ChosenLimits:
    """Choose limits for the image format and the number of beams of most frames.

    The limits for PNG images and 64 beams are preferred if they fit. Images count as JPEG if the
    files are JPEG, or if they show the borders of its blocks.

    Args:
        checks: Checks of frames from the whole drive.
        images: The image format. None: from the frames.
        beams: The number of beams. None: from the frames.
        are_jpeg_files: Whether the images are stored as JPEG.

    Raises:
        ValueError: There are no limits for this number of beams.
    """
    default = read_limits()
    found_images: ImageKind = images or _image_kind(
        checks, default.camera, are_jpeg_files=are_jpeg_files
    )
    found_beams = _beams(checks, default.lidar) if beams is None else beams
    warnings = []
    rings = _num_rings(checks)
    if beams is None and found_beams != 64:
        warnings.append(
            f"every sweep has about {rings:.0f} rings ahead, fewer than the 40 of 64 beams: it is "
            f"judged as of {found_beams} beams; if your LiDAR has another number, set "
            "--lidar-beams 64, 32 or 16, so that lost ones are detected"
        )
    return ChosenLimits(
        limits=shipped_limits(found_images, found_beams),
        camera=f"shipped, {found_images.upper()} pictures ({_origin(images)})",
        lidar=f"shipped, {found_beams} beams ({_origin(beams)})",
        warnings=tuple(warnings),
    )


def choose_for_dataset(
    dataset: SampleDataset, *, images: ImageKind | None = None, beams: int | None = None
) -> ChosenLimits:
    """Choose limits by frames spread over a data set, and by its image files.

    Frames that cannot be read do not count.

    Args:
        dataset: The data set, with images and sweeps.
        images: The image format. None: from the frames.
        beams: The number of beams. None: from the frames.

    Raises:
        ValueError: There are no limits for this number of beams.
    """
    files = [each["image"] for each in list_sample_files(dataset) if "image" in each]
    num_jpeg = sum(each.suffix.lower() in _JPEG_SUFFIXES for each in files)
    return choose_shipped(
        check_frames(_spread_samples(dataset)),
        images=images,
        beams=beams,
        are_jpeg_files=2 * num_jpeg > len(files),
    )


def _spread_samples(dataset: SampleDataset) -> Iterator[CameraLidarSample]:
    last, num_steps = len(dataset) - 1, _NUM_CHECKED_FRAMES - 1
    for index in sorted({round(n * last / num_steps) for n in range(_NUM_CHECKED_FRAMES)}):
        with suppress(ValueError):
            yield dataset[index]


def check_first(count: int | None) -> None:
    """Check that there are enough first frames to fit limits to.

    Raises:
        ValueError: There are too few.
    """
    if count is not None and count < MIN_FIRST_FRAMES:
        raise ValueError(
            f"--fit-first needs at least {MIN_FIRST_FRAMES} frames, got {count}; give 30"
        )


def fit_to_first(base: ChosenLimits, checks: DriveChecks) -> ChosenLimits:
    """Fit limits of camera and LiDAR to the first frames of a drive.

    Each check's median is that of the frames; its spread is that of the included limits, or twice
    the distance from the median to the worst of the frames, whichever is wider. The alignment's
    limits are unchanged, so that a LiDAR rotated from the start is detected.

    Args:
        base: The included limits that fit best.
        checks: Checks of the first frames.

    Raises:
        ValueError: There are too few frames with output of a sensor.
    """
    counts = {"camera": len(checks.camera), "lidar": len(checks.lidar)}
    for name, count in counts.items():
        if count < MIN_FIRST_FRAMES and (count or not any(counts.values())):
            raise ValueError(
                f"--fit-first needs at least {MIN_FIRST_FRAMES} frames with {name} output, "
                f"got {count}; give more frames, or omit it"
            )
    limits = base.limits
    descriptions = {"camera": base.camera, "lidar": base.lidar}
    if checks.camera:
        limits = replace(limits, camera=_centred_limits(limits.camera, checks.camera))
    if checks.lidar:
        limits = replace(limits, lidar=_centred_limits(limits.lidar, checks.lidar))
    for name, count in counts.items():
        if count:
            descriptions[name] = f"fitted to the first {count} frames, from {descriptions[name]}"
    fitted = max(counts.values())
    warning = (
        f"limits were fitted to the first {fitted} frames, which are assumed to be sound: "
        "faults in these frames are not detected"
    )
    warnings = (*base.warnings, warning)
    return ChosenLimits(
        limits=limits, camera=descriptions["camera"], lidar=descriptions["lidar"], warnings=warnings
    )


def _centred_limits(base: SensorLimits, rows: Sequence[Checks]) -> SensorLimits:
    values = np.array(rows, dtype=np.float64)
    ranges = {}
    for name, column in zip(rows[0]._fields, values.T, strict=True):
        finite = column[np.isfinite(column)]
        default = base.checks[name]
        if len(finite):
            middle = float(np.median(finite))
            reach = _SPREAD_FACTOR * (float(finite.max()) - middle)
            default = CheckRange(median=middle, spread=max(default.spread, reach))
        ranges[name] = default
    return replace(base, checks=ranges)


def _image_kind(checks: DriveChecks, default: SensorLimits, *, are_jpeg_files: bool) -> ImageKind:
    if not checks.camera or _fits(default, checks.camera):
        return "png"
    blocky = float(np.median([each.blocky for each in checks.camera]))
    return "jpeg" if are_jpeg_files or blocky > _MIN_JPEG_BLOCKINESS else "png"


def _beams(checks: DriveChecks, default: SensorLimits) -> int:
    if not checks.lidar:
        return 64
    rings = _num_rings(checks)
    ring_range = default.checks["ringless"]
    if ring_range.excess(-np.log2(rings)) < default.limit:
        return 64
    return min(BEAMS, key=lambda each: abs(np.log2(_RINGS_AHEAD[each] / rings)))


def _num_rings(checks: DriveChecks) -> float:
    counts = [2.0**-each.ringless for each in checks.lidar]
    return float(np.quantile(counts, _RING_QUANTILE)) if counts else 0.0


def _fits(limits: SensorLimits, rows: Sequence[Checks]) -> bool:
    """Test whether most frames are sound by these limits."""
    return sum(limits.judge(each).is_alarm for each in rows) <= _MAX_ALARM_SHARE * len(rows)


def _origin(given: object) -> str:
    return "recognised" if given is None else "as given"

"""Limits that come with Sightline, and which of them fit the frames of a drive."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np

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
from sightline.structures.sample import CameraLidarSample

ImageKind = Literal["png", "jpeg"]
"""How pictures were saved: without loss, or as JPEG of quality 75 to 95."""
BEAMS: Final = (64, 32, 16)
"""Numbers of beams that there are limits for."""

LOOKED_AT: Final = 15
"""Frames, evenly spread over a drive, that the shipped limits are chosen by."""
FEWEST_FIRST: Final = 10
"""Frames that limits of the drive itself can be fitted to, at least."""

_RINGS_AHEAD = {64: 40.0, 32: 20.0, 16: 10.0}  # in the part of a sweep that is looked at
_BLOCKY = 0.045  # of JPEG's blocks in pictures, the median; without compression it is below 0.035
_MOST_ALARMS = 0.2  # of frames, up to which limits fit: a sensor may have failed in some
_MOST_RINGS = 0.8  # quantile over the frames: in some a LiDAR may have failed
_WIDER = 2.0  # by how much limits of few frames reach beyond what these show


@dataclass(frozen=True, kw_only=True, slots=True)
class DriveChecks:
    """Checks of some frames of a drive, without those that a sensor delivered nothing in."""

    camera: tuple[CameraChecks, ...]
    lidar: tuple[LidarChecks, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class ChosenLimits:
    """Limits for a drive, and what was chosen."""

    limits: HealthLimits
    camera: str
    """Limits by which the camera is judged, in words."""
    lidar: str
    """Likewise for the LiDAR and the alignment."""
    warnings: tuple[str, ...] = ()


def shipped_limits(images: ImageKind = "png", beams: int = 64) -> HealthLimits:
    """Limits for a camera's pictures and a LiDAR's beams; the alignment's go by the beams.

    Raises:
        ValueError: There are none for so many beams.
    """
    if beams not in BEAMS:
        raise ValueError(
            f"there are limits for LiDARs of {', '.join(map(str, BEAMS))} beams, got {beams}; name "
            "the nearest"
        )
    for_camera, for_lidar = (
        read_limits(SHIPPED if name is None else SHIPPED.with_name(f"limits_{name}.json"))
        for name in (None if images == "png" else images, None if beams == 64 else beams)
    )
    return replace(for_lidar, camera=for_camera.camera)


def check_frames(samples: Iterable[CameraLidarSample]) -> DriveChecks:
    """Checks of all frames whose image, or whose sweep, is there and holds something."""
    camera: list[CameraChecks] = []
    lidar: list[LidarChecks] = []
    for sample in samples:
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
    """Limits for the kind of pictures and the number of beams that most frames show.

    Those for PNG pictures and 64 beams are taken wherever they fit. Pictures count as JPEG if they
    are such files, or show the borders of its blocks.

    Args:
        checks: Of frames from all over the drive.
        images: The kind of pictures. None: by the frames.
        beams: The number of beams. None: by the frames.
        are_jpeg_files: Whether the pictures are stored as JPEG.

    Raises:
        ValueError: There are no limits for so many beams.
    """
    usual = read_limits()
    found_images: ImageKind = images or _image_kind(
        checks, usual.camera, are_jpeg_files=are_jpeg_files
    )
    found_beams = _beams(checks, usual.lidar) if beams is None else beams
    warnings = []
    rings = _num_rings(checks)
    if beams is None and found_beams != 64:
        warnings.append(
            f"every sweep has about {rings:.0f} rings ahead, fewer than the 40 of 64 beams: it is "
            f"judged as of {found_beams} beams; if your LiDAR has 64, it has lost some: give "
            "--lidar-beams 64"
        )
    return ChosenLimits(
        limits=shipped_limits(found_images, found_beams),
        camera=f"shipped, {found_images.upper()} pictures ({_how(images)})",
        lidar=f"shipped, {found_beams} beams ({_how(beams)})",
        warnings=tuple(warnings),
    )


def check_first(count: int | None) -> None:
    """Refuse numbers of first frames that limits cannot be fitted to.

    Raises:
        ValueError: There are too few.
    """
    if count is not None and count < FEWEST_FIRST:
        raise ValueError(
            f"--fit-first needs at least {FEWEST_FIRST} frames, got {count}; 30 will do"
        )


def fit_to_first(base: ChosenLimits, checks: DriveChecks) -> ChosenLimits:
    """Limits of camera and LiDAR about what the first frames of a drive show.

    Each check's median is that of the frames; its spread is that of the shipped limits, or twice
    from the median to the worst of the frames, whichever is wider. The alignment's limits stay: a
    LiDAR that is turned from the start shall be seen.

    Args:
        base: The shipped limits that come nearest.
        checks: Of the first frames.

    Raises:
        ValueError: There are too few frames that hold something of a sensor.
    """
    counts = {"camera": len(checks.camera), "lidar": len(checks.lidar)}
    for name, count in counts.items():
        if count < FEWEST_FIRST and (count or not any(counts.values())):
            raise ValueError(
                f"--fit-first needs at least {FEWEST_FIRST} frames in which the {name} delivered "
                f"something, got {count}; name more frames, or leave it out"
            )
    limits = base.limits
    said = {"camera": base.camera, "lidar": base.lidar}
    if checks.camera:
        limits = replace(limits, camera=_about(limits.camera, checks.camera))
    if checks.lidar:
        limits = replace(limits, lidar=_about(limits.lidar, checks.lidar))
    for name, count in counts.items():
        if count:
            said[name] = f"fitted to the first {count} frames, from {said[name]}"
    fitted = max(counts.values())
    warning = (
        f"limits were fitted to the first {fitted} frames, which are taken as sound: what is "
        "wrong in them already is not seen"
    )
    warnings = (*base.warnings, warning)
    return ChosenLimits(
        limits=limits, camera=said["camera"], lidar=said["lidar"], warnings=warnings
    )


def _about(base: SensorLimits, rows: Sequence[Checks]) -> SensorLimits:
    values = np.array(rows, dtype=np.float64)
    ranges = {}
    for name, column in zip(rows[0]._fields, values.T, strict=True):
        known = column[np.isfinite(column)]
        usual = base.checks[name]
        if len(known):
            middle = float(np.median(known))
            reach = _WIDER * (float(known.max()) - middle)
            usual = CheckRange(median=middle, spread=max(usual.spread, reach))
        ranges[name] = usual
    return replace(base, checks=ranges)


def _image_kind(checks: DriveChecks, usual: SensorLimits, *, are_jpeg_files: bool) -> ImageKind:
    if not checks.camera or _fits(usual, checks.camera):
        return "png"
    blocky = float(np.median([each.blocky for each in checks.camera]))
    return "jpeg" if are_jpeg_files or blocky > _BLOCKY else "png"


def _beams(checks: DriveChecks, usual: SensorLimits) -> int:
    if not checks.lidar:
        return 64
    rings = _num_rings(checks)
    of_rings = usual.checks["ringless"]
    if of_rings.excess(-np.log2(rings)) < usual.limit:
        return 64
    return min(BEAMS, key=lambda each: abs(np.log2(_RINGS_AHEAD[each] / rings)))


def _num_rings(checks: DriveChecks) -> float:
    counts = [2.0**-each.ringless for each in checks.lidar]
    return float(np.quantile(counts, _MOST_RINGS)) if counts else 0.0


def _fits(limits: SensorLimits, rows: Sequence[Checks]) -> bool:
    """True if most frames are sound by these limits."""
    return sum(limits.judge(each).is_alarm for each in rows) <= _MOST_ALARMS * len(rows)


def _how(given: object) -> str:
    return "recognised" if given is None else "as given"

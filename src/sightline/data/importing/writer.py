"""Writes what is imported as a recording, frame by frame."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from sightline.data.atomic import atomic_write_text
from sightline.data.calibration_text import CalibrationMatrices
from sightline.data.importing.frames import Rigid
from sightline.data.recording_calibration import RecordingCalibration, recording_calibration_text
from sightline.data.recording_checks import (
    describe_recording,
    first_whole,
    view_of_recording,
)
from sightline.data.recording_tree import (
    CALIBRATIONS,
    IMAGES,
    LABELS,
    POINTS,
    TIMES_NAME,
    list_recording,
)
from sightline.data.velodyne import write_sweep

RESULTS = (f"{IMAGES}/*", f"{POINTS}/*", f"{LABELS}/*", f"{CALIBRATIONS}*", TIMES_NAME)
"""Patterns of what an import writes."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ImportReport:
    """What an import did; `str` gives it in lines for people."""

    out: Path
    written: int
    skipped: int
    """Frames that were there already."""
    notes: tuple[str, ...]
    """What was paired and dropped, by which topics, and how well the calibration fits."""

    def __str__(self) -> str:
        """The notes, then the numbers."""
        there = f"{self.skipped} were there already"
        return "\n".join((*self.notes, f"{self.out}: {self.written} frames written, {there}"))


def turned(calibration: RecordingCalibration, new_from_old: Rigid) -> RecordingCalibration:
    """The calibration of clouds that are moved by `new_from_old`."""
    matrices = CalibrationMatrices(
        image_from_camera=calibration.matrices.image_from_camera,
        camera_from_lidar=calibration.matrices.camera_from_lidar @ np.linalg.inv(new_from_old),
    )
    return replace(calibration, matrices=matrices)


def write_cloud(
    out: Path, name: str, points: Float32[np.ndarray, "num_points 4"], new_from_old: Rigid
) -> None:
    """Writes a frame's cloud, moved by `new_from_old`."""
    moved = points.copy()
    places = points[:, :3].astype(np.float64) @ new_from_old[:3, :3].T + new_from_old[:3, 3]
    moved[:, :3] = places
    write_sweep(out / POINTS / f"{name}.bin", moved)


def write_calibration(
    out: Path, calibration: RecordingCalibration, name: str | None = None
) -> None:
    """Writes the calibration of all frames, or that of one."""
    place = f"{CALIBRATIONS}.yaml" if name is None else f"{CALIBRATIONS}/{name}.yaml"
    atomic_write_text(out / place, recording_calibration_text(calibration))


def write_times(out: Path, times_s: dict[str, float]) -> None:
    """Writes when each frame was taken."""
    lines = (f"{name} {seconds:.9f}\n" for name, seconds in times_s.items())
    atomic_write_text(out / TIMES_NAME, "".join(lines))


def names_present(out: Path, *folders: str) -> set[str]:
    """The frames that have a file in each of the folders."""
    return set.intersection(*({path.stem for path in (out / name).glob("*")} for name in folders))


def describe_view(out: Path) -> tuple[str, ...]:
    """How what was written fits, in a line each, and a warning if need be."""
    frames = list_recording(out).frames
    view = view_of_recording(first_whole(frames))
    doubt = None if view is None else view.doubt
    return (*describe_recording(frames), *(() if doubt is None else (f"warning: {doubt}",)))

"""Simulated data sets on disk: resumable, in parallel, the same bytes whatever happens."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Final

from sightline.data.atomic import atomic_write_text
from sightline.data.object_tree import Velodyne
from sightline.data.parallel import run_pieces
from sightline.data.progress import track
from sightline.simulation.simulator import (
    SimulationConfig,
    StreetMaker,
    simulate_course,
    simulate_frame,
)
from sightline.simulation.street import make_street
from sightline.simulation.writer import DATE, DriveLayout, ObjectLayout

MANIFEST_NAME: Final = "simulation.json"
"""File in an output folder that says what made the others."""


@dataclass(frozen=True, kw_only=True, slots=True)
class SimulationResult:
    """What a run did."""

    written: int
    """Frames."""
    skipped: int
    """Frames that were there already."""


def simulate(
    out: Path,
    *,
    frames: int,
    config: SimulationConfig,
    workers: int = 2,
    velodyne: Velodyne = "velodyne",
    validation_frames: int = 0,
    streets: StreetMaker = make_street,
) -> SimulationResult:
    """Writes simulated frames as KITTI's object tree, or drives in the layout of its recordings.

    `writer.ObjectLayout` and, where `config.sequence_length` is above 1, `writer.DriveLayout` say
    which files there are. A file appears whole or not at all, and frames that are there are
    skipped, so a run that was stopped goes on where it was; with more frames it extends what is
    there. The same settings give the same bytes for any number of workers.

    Args:
        out: Folder for all of it; its simulation.json says which settings made it.
        frames: How many, over all drives.
        config: What is simulated.
        workers: Processes that work; 1 is this process alone.
        velodyne: Whole turns of the LiDAR, or "velodyne_reduced": only what the camera sees.
        validation_frames: So many, the first ones, go to ImageSets/val.txt and not to train.txt.
        streets: Makes the places; a function of a module.

    Raises:
        ValueError: `out` holds data of other settings or cannot be written to, or the numbers
            make no sense. Errors about a frame name it; frames done before stay done.
    """
    if frames < 1 or workers < 1 or not 0 <= validation_frames <= frames:
        raise ValueError(
            "a simulation needs at least 1 frame and 1 worker and no more validation_frames than "
            f"frames, got {frames}, {workers} and {validation_frames}"
        )
    if config.sequence_length > 1 and (validation_frames or velodyne != "velodyne"):
        raise ValueError(
            "drives have whole sweeps and no validation_frames; leave both out, or make single "
            "frames with a sequence_length of 1"
        )
    _claim(out, _settings(config, velodyne, validation_frames, streets))
    if config.sequence_length > 1:
        return _simulate_drives(out, frames, config, workers, streets)
    layout = ObjectLayout(root=out, velodyne=velodyne)
    frames = max(frames, layout.num_begun())  # what an earlier run began is finished, too
    pending = [index for index in range(frames) if not layout.frame(index).are_there()]
    _run([_FrameJob(layout, config, streets, index) for index in pending], workers)
    layout.write_lists(frames, validation_frames)
    return SimulationResult(written=len(pending), skipped=frames - len(pending))


def _simulate_drives(
    out: Path, frames: int, config: SimulationConfig, workers: int, streets: StreetMaker
) -> SimulationResult:
    layout = DriveLayout(root=out, sequence_length=config.sequence_length)
    frames = max(frames, layout.num_begun())
    layout.write_calibration(config.calibration)
    jobs: list[_FrameJob | _CourseJob] = []
    written = 0
    for drive, length in layout.drives(frames):
        first = drive * config.sequence_length
        indices = range(first, first + length)
        pending = [index for index in indices if not layout.frame(index).are_there()]
        if not layout.has_course(drive, length):
            jobs.append(_CourseJob(layout, config, streets, drive, length))
        jobs += [_FrameJob(layout, config, streets, index) for index in pending]
        written += len(pending)
    _run(jobs, workers)
    return SimulationResult(written=written, skipped=frames - written)


@dataclass(frozen=True, slots=True)
class _FrameJob:
    """Makes and writes a frame."""

    layout: ObjectLayout | DriveLayout
    config: SimulationConfig
    streets: StreetMaker
    index: int

    def __str__(self) -> str:
        return f"frame {self.index}"

    def run(self) -> None:
        frame = simulate_frame(self.config, self.index, self.streets)
        velodyne = self.layout.velodyne if isinstance(self.layout, ObjectLayout) else "velodyne"
        self.layout.frame(self.index).write(frame, velodyne)


@dataclass(frozen=True, slots=True)
class _CourseJob:
    """Writes poses and times of a drive."""

    layout: DriveLayout
    config: SimulationConfig
    streets: StreetMaker
    drive: int
    length: int

    def __str__(self) -> str:
        return f"drive {self.drive}"

    def run(self) -> None:
        poses = simulate_course(self.config, self.drive, self.length, self.streets)
        self.layout.write_course(self.drive, poses)


@dataclass(frozen=True, slots=True)
class _Attempt:
    """Does a job by its number and returns the error, empty if there is none."""

    jobs: Sequence[_FrameJob | _CourseJob]

    def __call__(self, position: int) -> str:
        job = self.jobs[position]
        try:
            job.run()
        except (ValueError, OSError) as error:
            return f"{job}: {error}"
        return ""


def _run(jobs: Sequence[_FrameJob | _CourseJob], workers: int) -> None:
    pieces = run_pieces(_Attempt(jobs), len(jobs), workers)
    for error in track(pieces, description="simulating", total=len(jobs)):
        if error:
            raise ValueError(error)


def _settings(
    config: SimulationConfig, velodyne: Velodyne, validation_frames: int, streets: StreetMaker
) -> dict[str, object]:
    """All that the bytes depend on, but for the number of frames."""
    return {
        "sightline": version("sightline"),
        "streets": f"{streets.__module__}.{streets.__qualname__}",
        "velodyne": velodyne,
        "validation_frames": validation_frames,
        **asdict(config),
    }


def _claim(out: Path, settings: dict[str, object]) -> None:
    """Writes the manifest to an output folder, or sees that it stands there already."""
    path = out / MANIFEST_NAME
    text = json.dumps(settings, indent=2) + "\n"
    there = path.read_text(errors="replace") if path.is_file() else None
    if there == text:
        return
    if out.exists() and not out.is_dir():
        raise ValueError(f"{out} is no folder; name another output folder")
    if there is not None or (out / "training").exists() or (out / DATE).exists():
        raise ValueError(
            f"{out} holds {_difference(there, text)}, which would mix with this run; name another "
            "output folder or empty this one"
        )
    atomic_write_text(path, text)


def _difference(there: str | None, wanted: str) -> str:
    """What the folder's files were made with that this run is not."""
    if there is None:
        return f"data without a {MANIFEST_NAME}"
    try:
        before = json.loads(there)
    except ValueError:
        before = None
    if not isinstance(before, dict):
        return f"a damaged {MANIFEST_NAME}"
    now = json.loads(wanted)
    names = [name for name in {**before, **now} if before.get(name) != now.get(name)]
    described = (f"{name} {before.get(name)} instead of {now.get(name)}" for name in names)
    return f"frames simulated with {', '.join(described) or 'the same settings, written otherwise'}"

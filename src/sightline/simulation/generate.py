"""Simulated data sets on disk: resumable, in parallel, the same bytes whatever happens."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

from sightline.data.jobs import JobResult, claim_folder, run_job
from sightline.data.object_tree import Velodyne
from sightline.simulation.simulator import (
    SimulationConfig,
    StreetMaker,
    simulate_course,
    simulate_frame,
)
from sightline.simulation.street import make_street
from sightline.simulation.writer import DATE, DriveLayout, ObjectLayout

SIMULATOR_REVISION: Final = 4
"""Of what the frames look like; raised by each change after which the same seed gives others."""
MANIFEST_NAME: Final = "simulation.json"
"""File in an output folder that says what made the others."""


def simulate(
    out: Path,
    *,
    frames: int,
    config: SimulationConfig,
    workers: int = 2,
    velodyne: Velodyne = "velodyne",
    validation_frames: int = 0,
    streets: StreetMaker = make_street,
) -> JobResult:
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
    whole = config.camera and not validation_frames and velodyne == "velodyne"
    if config.sequence_length > 1 and not whole:
        raise ValueError(
            "drives have images, whole sweeps and no validation_frames; keep to that, or make "
            "single frames with a sequence_length of 1"
        )
    settings = _settings(config, velodyne, validation_frames, streets)
    claim_folder(out, settings, results=("training", DATE), manifest_name=MANIFEST_NAME)
    if config.sequence_length > 1:
        return _simulate_drives(out, frames, config, workers, streets)
    layout = ObjectLayout(root=out, velodyne=velodyne, camera=config.camera)
    frames = max(frames, layout.num_begun())  # what an earlier run began is finished, too
    pending = [index for index in range(frames) if not layout.frame(index).are_there()]
    works = [_FrameWork(layout, config, streets, index) for index in pending]
    run_job(works, workers, description="simulating")
    layout.write_lists(frames, validation_frames)
    return JobResult(written=len(pending), skipped=frames - len(pending))


def _simulate_drives(
    out: Path, frames: int, config: SimulationConfig, workers: int, streets: StreetMaker
) -> JobResult:
    layout = DriveLayout(root=out, sequence_length=config.sequence_length)
    frames = max(frames, layout.num_begun())
    layout.write_calibration(config.calibration)
    works: list[_FrameWork | _CourseWork] = []
    written = 0
    for drive, length in layout.drives(frames):
        first = drive * config.sequence_length
        indices = range(first, first + length)
        pending = [index for index in indices if not layout.frame(index).are_there()]
        if not layout.has_course(drive, length):
            works.append(_CourseWork(layout, config, streets, drive, length))
        works += [_FrameWork(layout, config, streets, index) for index in pending]
        written += len(pending)
    run_job(works, workers, description="simulating")
    return JobResult(written=written, skipped=frames - written)


@dataclass(frozen=True, slots=True)
class _FrameWork:
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
class _CourseWork:
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


def _settings(
    config: SimulationConfig, velodyne: Velodyne, validation_frames: int, streets: StreetMaker
) -> dict[str, object]:
    """All that the bytes depend on, but for the number of frames."""
    return {
        "revision": SIMULATOR_REVISION,
        "streets": f"{streets.__module__}.{streets.__qualname__}",
        "velodyne": velodyne,
        "validation_frames": validation_frames,
        **asdict(config),
    }

"""Simulated data sets on disk: resumable, parallel and reproducible to the byte."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

from sightline.data.object_tree import Velodyne
from sightline.jobs.output_dirs import acquire_output_dir
from sightline.jobs.run import JobResult, check_workers, run_job, shard
from sightline.simulation.settings import SimulationConfig
from sightline.simulation.simulator import (
    StreetMaker,
    calibration_of,
    simulate_course,
    simulate_frame,
)
from sightline.simulation.street import make_street
from sightline.simulation.writer import (
    DATE,
    MAX_DRIVES,
    MAX_FRAMES,
    DriveLayout,
    Layout,
    ObjectLayout,
)

SIMULATOR_REVISION: Final = 7
"""Revision of the simulator's output; raised by each change that alters a seed's frames."""
MANIFEST_NAME: Final = "simulation.json"
"""File in an output folder that records the settings of the other files."""


def simulate(
    out: Path,
    *,
    frames: int,
    config: SimulationConfig,
    workers: int = 2,
    velodyne: Velodyne = "velodyne",
    validation_frames: int = 0,
    streets: StreetMaker = make_street,
    shard_index: int = 0,
    num_shards: int = 1,
) -> JobResult:
    """Write simulated frames as KITTI's object tree, or drives in the layout of its raw data.

    `writer.ObjectLayout` and, where `config.sequence_length` is above 1, `writer.DriveLayout`
    define the files. A file appears whole or not at all, and existing frames are skipped, so a
    stopped run can be resumed; a larger `frames` extends the data set. The same settings give the
    same bytes for any number of workers.

    Args:
        out: Output folder; its simulation.json records the settings.
        frames: Number of frames, over all drives.
        config: Settings of the simulation.
        workers: Number of processes; 1 uses this process alone.
        velodyne: Whole turns of the LiDAR, or "velodyne_reduced" for only the points within view of
            the camera.
        validation_frames: Number of frames, the first ones, that go to ImageSets/val.txt instead of
            train.txt.
        streets: Maker of the streets; a module-level function.
        shard_index: Part of the frames, or of the drives, to simulate, from 0. Each part writes the
            lists and the files common to all drives.
        num_shards: Number of parts; parts can run on separate machines at the same time.

    Raises:
        ValueError: `out` holds data of other settings, or a sweep far beyond the others and the
            requested frames, or is not writable; or the numbers are invalid. Errors about a frame
            contain its name; finished frames are kept.
    """
    check_workers(workers)
    if frames < 1 or not 0 <= validation_frames <= frames:
        raise ValueError(
            "a simulation needs at least 1 frame and no more validation_frames than frames, got "
            f"{frames} and {validation_frames}"
        )
    most = MAX_FRAMES if config.sequence_length == 1 else MAX_DRIVES * config.sequence_length
    if frames > most:
        raise ValueError(
            f"a simulation has at most {most} frames, as many as its files have names for, got "
            f"{frames}; make several folders, each with another seed"
        )
    shard((), shard_index, num_shards)  # rejects invalid values before the folder is claimed
    whole = config.camera and not validation_frames and velodyne == "velodyne"
    if config.sequence_length > 1 and not whole:
        raise ValueError(
            "drives have images, whole sweeps and no validation_frames; keep to that, or make "
            "single frames with a sequence_length of 1"
        )
    settings = _settings(config, velodyne, validation_frames, streets)
    acquire_output_dir(out, settings, results=("training", DATE), manifest_name=MANIFEST_NAME)
    make = _Maker(config, streets, workers, shard_index, num_shards)
    if config.sequence_length > 1:
        return make.drives(DriveLayout(root=out, sequence_length=config.sequence_length), frames)
    layout = ObjectLayout(root=out, velodyne=velodyne, camera=config.camera)
    return make.frames(layout, frames, validation_frames)


@dataclass(frozen=True, slots=True)
class _Maker:
    """Maker of the missing files of one part, including files begun by earlier runs."""

    config: SimulationConfig
    streets: StreetMaker
    workers: int
    shard_index: int
    num_shards: int

    def frames(self, layout: ObjectLayout, frames: int, validation_frames: int) -> JobResult:
        frames = layout.num_planned(frames)
        result = self._run(layout, shard(range(frames), self.shard_index, self.num_shards), [])
        layout.write_lists(frames, validation_frames)
        return result

    def drives(self, layout: DriveLayout, frames: int) -> JobResult:
        drives = list(layout.drives(layout.num_planned(frames)))
        layout.write_calibration(calibration_of(self.config))
        mine = shard(drives, self.shard_index, self.num_shards)
        courses = [
            _CourseWork(layout, self.config, self.streets, drive, length)
            for drive, length in mine
            if not layout.has_course(drive, length)
        ]
        firsts = ((drive * layout.sequence_length, length) for drive, length in mine)
        indices = [first + step for first, length in firsts for step in range(length)]
        return self._run(layout, indices, courses)

    def _run(
        self, layout: Layout, indices: Sequence[int], courses: "list[_CourseWork]"
    ) -> JobResult:
        pending = [index for index in indices if not layout.frame(index).are_there()]
        works = [_FrameWork(layout, self.config, self.streets, index) for index in pending]
        run_job([*courses, *works], self.workers, description="simulating")
        return JobResult(written=len(pending), skipped=len(indices) - len(pending))


@dataclass(frozen=True, slots=True)
class _FrameWork:
    """Job that simulates and writes a frame."""

    layout: Layout
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
    """Job that writes poses and times of a drive."""

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
    """Collect all settings that affect the bytes, except the number of frames."""
    return {
        "revision": SIMULATOR_REVISION,
        "streets": f"{streets.__module__}.{streets.__qualname__}",
        "velodyne": velodyne,
        "validation_frames": validation_frames,
        **asdict(config),
    }

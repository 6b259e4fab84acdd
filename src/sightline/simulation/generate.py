"""Simulated data sets on disk, in KITTI's layouts: resumable and reproducible to the byte."""

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from datetime import datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float64

from sightline.data.formats.image_file import write_rgb
from sightline.data.formats.kitti_calibration import (
    CalibrationMatrices,
    check_intrinsics,
    object_calibration_text,
    raw_calibration_texts,
)
from sightline.data.formats.kitti_labels import write_objects
from sightline.data.formats.map_png import write_depth_png, write_instance_png
from sightline.data.formats.pixels import crop_to_view, sparse_depth_map
from sightline.data.formats.velodyne import write_sweep
from sightline.data.layouts.kitti_trees import Velodyne, list_drive
from sightline.data.layouts.recording_files import is_recording
from sightline.files.atomic import atomic_write_text
from sightline.files.extras import require_library
from sightline.files.problem import FileError
from sightline.geometry.choices import check_choices
from sightline.geometry.road_height import LidarPose
from sightline.geometry.wrong_types import named_arguments
from sightline.jobs.crew import Driver
from sightline.jobs.output_dirs import KITTI_SPLITS, acquire_output_dir, is_finished, is_split
from sightline.jobs.run import JobResult, check_workers, run_job, shard
from sightline.simulation.rig_sensors import Sensors
from sightline.simulation.settings import SimulationConfig
from sightline.simulation.simulator import (
    FRAME_S,
    SimulatedFrame,
    StreetMaker,
    sensors_of,
    simulate_course,
    simulate_frame,
)
from sightline.simulation.street import make_street

DATE = "2000_01_01"  # date of all simulated drives: not a real one
MAX_FRAMES = 10**6  # maximum number of frames: names have six digits
MAX_DRIVES = 10**4  # maximum number of drives: names have four digits
# Maximum number of parts of a job: the last part begins with the frame, or drive, of its number,
# and leaves as many between two. Files beyond this were not begun by a job.
_MAX_SHARDS = 1000
_LATER: Final = ("rig", "varied")
# Patterns of the folders of data sets and lists; an output folder of another origin has none.
_DATA: Final = (*KITTI_SPLITS, "ImageSets", DATE, "train/*/proj_depth", "val/*/proj_depth")
_DIGIT = "[0-9]"  # for patterns: other files in an output folder are not frames
_START = datetime(2000, 1, 1, 12)  # noqa: DTZ001 - KITTI's times name no zone


@dataclass(frozen=True, kw_only=True, slots=True)
class FrameFiles:
    """Output files of a frame."""

    image: Path | None  # image file; None without a camera
    points: Path
    objects: Path
    depth: Path  # dense depth of every pixel
    sparse_depth: Path  # depth of the pixels hit by the LiDAR: the depth benchmark's input
    instances: Path
    calibration: Path | None
    """Calibration file; None if the day's calibration applies to all frames."""

    def are_there(self) -> bool:
        """Whether all files are finished."""
        paths = [self.image, self.points, self.objects, self.depth, self.sparse_depth]
        paths += [self.instances, self.calibration]
        return all(path is None or is_finished(path) for path in paths)

    def write(self, frame: SimulatedFrame, velodyne: Velodyne) -> None:
        """Write all files atomically."""
        seen = crop_to_view(frame.points, frame.calibration, frame.image_size)
        sparse_depth = sparse_depth_map(frame.points, frame.calibration, frame.image_size)
        write_sweep(self.points, frame.points if velodyne == "velodyne" else seen)
        if self.image is not None and frame.image is not None:
            write_rgb(self.image, frame.image)
        write_objects(self.objects, frame.objects)
        write_depth_png(self.depth, frame.depth_m)
        write_depth_png(self.sparse_depth, sparse_depth)
        write_instance_png(self.instances, frame.instances)
        if self.calibration is not None:
            text = object_calibration_text(frame.calibration, frame.lidar_pose)
            atomic_write_text(self.calibration, text)


@dataclass(frozen=True, kw_only=True, slots=True)
class ObjectLayout:
    """KITTI's object tree, with additional ground truth of the simulator.

    training/{image_2,VELODYNE,calib,label_2}/N.* and training/{depth,velodyne_raw,instance}/N.png;
    ImageSets/{train,val}.txt.
    """

    root: Path
    velodyne: Velodyne
    camera: bool = True

    def __post_init__(self) -> None:
        """Check the choices."""
        check_choices(self)

    def frame(self, index: int) -> FrameFiles:
        """List the files of a frame."""
        folder, name = self.root / "training", f"{index:06d}"
        return FrameFiles(
            image=folder / "image_2" / f"{name}.png" if self.camera else None,
            points=folder / self.velodyne / f"{name}.bin",
            objects=folder / "label_2" / f"{name}.txt",
            depth=folder / "depth" / f"{name}.png",
            sparse_depth=folder / "velodyne_raw" / f"{name}.png",
            instances=folder / "instance" / f"{name}.png",
            calibration=folder / "calib" / f"{name}.txt",
        )

    def num_planned(self, frames: int) -> int:
        """Compute the number of frames requested, or begun: their sweeps are written first.

        Raises:
            FileError: The index of a sweep is too large to be from an earlier run.
        """
        sweeps = list((self.root / "training" / self.velodyne).glob(f"{_DIGIT * 6}.bin"))
        if not sweeps:
            return frames
        last = max(sweeps)
        max_index = _MAX_SHARDS * len(sweeps)
        return _planned(frames, int(last.stem), last, max_index=max_index)

    def write_lists(self, frames: int, validation_frames: int) -> None:
        """Write ImageSets/train.txt and, for any validation frames, val.txt: the first frames."""
        names = [f"{index:06d}\n" for index in range(frames)]
        lists = {"train": names[validation_frames:], "val": names[:validation_frames]}
        for name, lines in lists.items():
            if lines:
                atomic_write_text(self.root / "ImageSets" / f"{name}.txt", "".join(lines))


@dataclass(frozen=True, kw_only=True, slots=True)
class DriveLayout:
    """KITTI's raw data of one day, and the same drives as a depth completion tree.

    DATE/DRIVE/{image_02,velodyne_points,label_02,instance}/data/N.* with poses and times;
    train/DRIVE/proj_depth/{groundtruth,velodyne_raw}/image_02/N.png.
    """

    root: Path
    sequence_length: int

    def frame(self, index: int) -> FrameFiles:
        """List the files of a frame; `index` counts through all drives."""
        drive, step = divmod(index, self.sequence_length)
        folder, name = self.drive_folder(drive), f"{step:010d}"
        maps = self.root / "train" / folder.name / "proj_depth"
        return FrameFiles(
            image=folder / "image_02" / "data" / f"{name}.png",
            points=folder / "velodyne_points" / "data" / f"{name}.bin",
            objects=folder / "label_02" / "data" / f"{name}.txt",
            depth=maps / "groundtruth" / "image_02" / f"{name}.png",
            sparse_depth=maps / "velodyne_raw" / "image_02" / f"{name}.png",
            instances=folder / "instance" / "data" / f"{name}.png",
            calibration=None,
        )

    def drive_folder(self, drive: int) -> Path:
        """Folder of a drive's raw data."""
        return self.root / DATE / f"{DATE}_drive_{drive:04d}_sync"

    def num_planned(self, frames: int) -> int:
        """Compute the number of frames requested, or begun: their sweeps are written first.

        Raises:
            FileError: The index of a sweep is too large to be from an earlier run.
        """
        last_sweeps: dict[Path, Path] = {}
        for folder in (self.root / DATE).glob(f"{DATE}_drive_{_DIGIT * 4}_sync"):
            sweeps = (folder / "velodyne_points" / "data").glob(f"{_DIGIT * 10}.bin")
            planned_sweeps = [sweep for sweep in sweeps if int(sweep.stem) < self.sequence_length]
            if planned_sweeps:
                last_sweeps[folder] = max(planned_sweeps)
        if not last_sweeps:
            return frames
        folder = max(last_sweeps)
        drive, last = int(folder.name.split("_")[-2]), last_sweeps[folder]
        index = drive * self.sequence_length + int(last.stem)
        max_index = _MAX_SHARDS * len(last_sweeps) * self.sequence_length
        return _planned(frames, index, last, max_index=max_index)

    def drives(self, frames: int) -> Iterator[tuple[int, int]]:
        """Yield each drive and its number of frames, the last one possibly shorter."""
        for first in range(0, frames, self.sequence_length):
            yield first // self.sequence_length, min(self.sequence_length, frames - first)

    def write_calibration(self, calibration: CalibrationMatrices, pose: LidarPose | None) -> None:
        """Write the day's calibration, with the LiDAR's mount if it is another than KITTI's."""
        cameras, lidar = raw_calibration_texts(calibration, pose)
        atomic_write_text(self.root / DATE / "calib_cam_to_cam.txt", cameras)
        atomic_write_text(self.root / DATE / "calib_velo_to_cam.txt", lidar)

    def has_course(self, drive: int, length: int) -> bool:
        """Whether the poses and times of a drive of this length exist."""
        return all(
            path.is_file() and path.read_bytes().count(b"\n") == length
            for path in self._course_files(drive)
        )

    def write_course(
        self, drive: int, world_from_lidar: Float64[np.ndarray, "num_frames 4 4"]
    ) -> None:
        """Write the poses (3x4, row by row) and the times of a drive."""
        poses, *times = self._course_files(drive)
        rows = world_from_lidar[:, :3].reshape(-1, 12).tolist()
        atomic_write_text(poses, "".join(" ".join(map(repr, row)) + "\n" for row in rows))
        moments = (_START + timedelta(seconds=step * FRAME_S) for step in range(len(rows)))
        text = "".join(f"{moment:%Y-%m-%d %H:%M:%S.%f}000\n" for moment in moments)
        for path in times:
            atomic_write_text(path, text)

    def _course_files(self, drive: int) -> tuple[Path, Path, Path]:
        folder = self.drive_folder(drive)
        return (
            folder / "poses.txt",
            folder / "image_02" / "timestamps.txt",
            folder / "velodyne_points" / "timestamps.txt",
        )


def _planned(frames: int, index: int, sweep: Path, *, max_index: int) -> int:
    """Compute the number of frames up to `index`, the last sweep's, or `frames` if it is larger."""
    if index >= max(frames, max_index):
        raise FileError(
            sweep,
            f"is the sweep of frame {index}, expected an index below {max(frames, max_index)} "
            "with so few other sweeps",
            f"move it away, or request {index + 1} frames",
        )
    return max(frames, index + 1)


Layout = ObjectLayout | DriveLayout


SIMULATOR_REVISION: Final = 7
"""Revision of the simulator's output; raised by each change that alters a seed's frames."""
MANIFEST_NAME: Final = "simulation.json"
"""File in an output folder that records the settings of the other files."""


@named_arguments
def simulate(
    out: Path,
    *,
    frames: int,
    config: SimulationConfig,
    workers: int = 2,
    driver: Driver = "local",
    velodyne: Velodyne = "velodyne",
    validation_frames: int = 0,
    streets: StreetMaker = make_street,
    shard_index: int = 0,
    num_shards: int = 1,
) -> JobResult:
    """Write simulated frames as KITTI's object tree, or drives in the layout of its raw data.

    `ObjectLayout` and, where `config.sequence_length` is above 1, `DriveLayout` define the files.
    Files are written atomically, and existing frames are skipped, so a stopped run can be resumed;
    a larger `frames` extends the data set. The same settings give the same bytes for any number of
    workers.

    Args:
        out: Output folder; its simulation.json records the settings.
        frames: Number of frames, over all drives.
        config: Settings of the simulation.
        workers: Number of workers; 1 on this machine uses this process alone.
        driver: Kind of workers: processes of this machine, or actors of a Ray cluster.
        velodyne: Whole turns of the LiDAR, or "velodyne_reduced" for only the points within view of
            the camera.
        validation_frames: Number of frames, the first ones, that go to ImageSets/val.txt instead of
            train.txt.
        streets: Maker of the streets; a module-level function.
        shard_index: Part of the frames, or of the drives, to simulate, from 0. Each part writes the
            lists and the files common to all drives.
        num_shards: Number of parts; parts can run on separate machines at the same time.

    Raises:
        ValueError: embreex is not installed; `out` holds data of other settings or of another
            origin, or a sweep far beyond the others and the requested frames, or is not writable;
            or the numbers are invalid. Errors about a frame contain its name; finished frames are
            kept.
    """
    check_workers(workers, driver)
    check_simulation(config, frames, validation_frames=validation_frames, velodyne=velodyne)
    shard((), shard_index, num_shards)  # rejects invalid values before the folder is claimed
    settings = {  # all that affects the bytes, except the number of frames
        "revision": SIMULATOR_REVISION,
        "streets": f"{streets.__module__}.{streets.__qualname__}",
        "velodyne": velodyne,
        "validation_frames": validation_frames,
        **_recorded(config),
    }
    _check_no_data_set(out)
    acquire_output_dir(out, settings, results=_DATA, manifest_name=MANIFEST_NAME)
    works: list[_Work] = []
    layout: Layout
    if config.sequence_length > 1:
        layout = DriveLayout(root=out, sequence_length=config.sequence_length)
        drives = list(layout.drives(layout.num_planned(frames)))
        sensors = sensors_of(config, 0)
        layout.write_calibration(sensors.calibration, sensors.lidar_pose)
        indices: list[int] = []
        for drive, length in shard(drives, shard_index, num_shards):
            first = drive * layout.sequence_length
            indices += range(first, first + length)
            if not layout.has_course(drive, length):
                action = partial(_write_course, layout, config, streets, drive, length)
                works.append(_Work(f"drive {drive}", action))
    else:
        layout = ObjectLayout(root=out, velodyne=velodyne, camera=config.camera)
        frames = layout.num_planned(frames)
        indices = list(shard(range(frames), shard_index, num_shards))
    pending = [index for index in indices if not layout.frame(index).are_there()]
    for index in pending:
        action = partial(_write_frame, layout, config, streets, velodyne, index)
        works.append(_Work(f"frame {index}", action))
    run_job(works, workers, description="simulating", driver=driver)
    if isinstance(layout, ObjectLayout):
        layout.write_lists(frames, validation_frames)
    return JobResult(written=len(pending), skipped=len(indices) - len(pending))


@named_arguments
def check_simulation(
    config: SimulationConfig,
    frames: int,
    *,
    validation_frames: int = 0,
    velodyne: Velodyne = "velodyne",
) -> None:
    """Check the settings of `simulate`, before a folder is claimed for them.

    Raises:
        ValueError: embreex is not installed, or the numbers or the rig are invalid.
    """
    if frames < 1 or not 0 <= validation_frames <= frames:
        raise ValueError(
            f"frames must be at least 1, got {frames}, and validation_frames from 0 to as many, "
            f"got {validation_frames}; set both, as a preset has numbers of its own"
        )
    max_frames = MAX_FRAMES if config.sequence_length == 1 else MAX_DRIVES * config.sequence_length
    if frames > max_frames:
        raise ValueError(
            f"a simulation has at most {max_frames} frames, as many as it has names for, got "
            f"{frames}; make several folders, each with another seed"
        )
    whole = config.camera and not validation_frames and velodyne == "velodyne"
    if config.sequence_length > 1 and not whole:
        raise ValueError(
            "drives have images, whole sweeps and no validation_frames; keep to that, or make "
            "single frames with a sequence_length of 1"
        )
    require_library("embreex", "simulate")
    _check_readable(sensors_of(config, 0))


def _check_no_data_set(out: Path) -> None:
    """Refuse a recording, a raw drive or a split that is not simulated."""
    if not out.is_dir() or (out / MANIFEST_NAME).exists():
        return
    if is_recording(out) or list_drive(out).frames or is_split(out) or is_split(out.resolve()):
        raise ValueError(
            f"{out} is a data set, or a split of one, that was not simulated: frames and lists of "
            "this job would mix with its own; name another output folder"
        )


def _check_readable(sensors: Sensors) -> None:
    """Refuse a camera whose calibration no command would read."""
    size, projection = sensors.image_size, sensors.calibration.image_from_camera
    for fault in check_intrinsics(projection[:, :3], size, Path(), usual=False):
        raise ValueError(
            f"the camera {fault.problem}, so no command would read the data; choose a larger image "
            "or another focal length"
        )


def _recorded(config: SimulationConfig) -> dict[str, Any]:
    """Select the settings that a folder records.

    Later ones are recorded only where set, so that folders made before can be resumed.
    """
    settings = asdict(config)
    return {name: settings[name] for name in settings if name not in _LATER or settings[name]}


@dataclass(frozen=True, slots=True)
class _Work:
    """Named part of a job; a worker process runs it."""

    name: str
    run: Callable[[], None]

    def __str__(self) -> str:
        return self.name


def _write_frame(
    layout: Layout, config: SimulationConfig, streets: StreetMaker, velodyne: Velodyne, index: int
) -> None:
    layout.frame(index).write(simulate_frame(config, index, streets), velodyne)


def _write_course(
    layout: DriveLayout, config: SimulationConfig, streets: StreetMaker, drive: int, length: int
) -> None:
    """Write poses and times of a drive."""
    layout.write_course(drive, simulate_course(config, drive, length, streets))

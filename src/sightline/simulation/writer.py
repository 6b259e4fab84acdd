"""Files of a simulated data set: KITTI's object tree, or its raw data and depth tree."""

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from sightline.data.calibration_text import (
    CalibrationMatrices,
    object_calibration_text,
    raw_calibration_texts,
)
from sightline.data.depth_png import write_depth_png
from sightline.data.image_file import write_rgb
from sightline.data.instance_png import write_instance_png
from sightline.data.kitti_labels import write_objects
from sightline.data.object_tree import Velodyne
from sightline.data.pixels import seen_by_camera, sparse_depth_map
from sightline.data.velodyne import write_sweep
from sightline.files.atomic import atomic_write_text
from sightline.files.problem import FileError
from sightline.simulation.simulator import FRAME_S, SimulatedFrame

DATE = "2000_01_01"
"""Date of all simulated drives: not a real one."""
MAX_FRAMES = 10**6
"""Maximum number of frames: names have six digits."""
MAX_DRIVES = 10**4
"""Maximum number of drives: names have four digits."""
# Maximum number of parts of a job: the last part begins with the frame, or drive, of its number,
# and leaves as many between two. Files beyond this were not begun by a job.
_MAX_SHARDS = 1000
_DIGIT = "[0-9]"  # for patterns: other files in an output folder are not frames
_START = datetime(2000, 1, 1, 12)  # noqa: DTZ001 - KITTI's times name no zone


@dataclass(frozen=True, kw_only=True, slots=True)
class FrameFiles:
    """Output files of a frame."""

    image: Path | None
    """Image file; None without a camera."""
    points: Path
    objects: Path
    depth: Path
    """Dense depth of every pixel."""
    sparse_depth: Path
    """Depth of the pixels hit by the LiDAR: the depth benchmark's input."""
    instances: Path
    calibration: Path | None
    """Calibration file; None if the day's calibration applies to all frames."""

    def are_there(self) -> bool:
        """Whether all files exist; an existing file is complete."""
        paths = [self.image, self.points, self.objects, self.depth, self.sparse_depth]
        paths += [self.instances, self.calibration]
        return all(path is None or path.is_file() for path in paths)

    def write(self, frame: SimulatedFrame, velodyne: Velodyne) -> None:
        """Write all files atomically."""
        seen = seen_by_camera(frame.points, frame.calibration, frame.image_size)
        sparse_depth = sparse_depth_map(frame.points, frame.calibration, frame.image_size)
        write_sweep(self.points, frame.points if velodyne == "velodyne" else seen)
        if self.image is not None and frame.image is not None:
            write_rgb(self.image, frame.image)
        write_objects(self.objects, frame.objects)
        write_depth_png(self.depth, frame.depth_m)
        write_depth_png(self.sparse_depth, sparse_depth)
        write_instance_png(self.instances, frame.instances)
        if self.calibration is not None:
            atomic_write_text(self.calibration, object_calibration_text(frame.calibration))


@dataclass(frozen=True, kw_only=True, slots=True)
class ObjectLayout:
    """KITTI's object tree, with additional ground truth of the simulator.

    training/{image_2,VELODYNE,calib,label_2}/N.* and training/{depth,velodyne_raw,instance}/N.png;
    ImageSets/{train,val}.txt.
    """

    root: Path
    velodyne: Velodyne
    camera: bool = True

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
            FileError: A sweep lies far beyond anything that earlier runs can have begun.
        """
        sweeps = list((self.root / "training" / self.velodyne).glob(f"{_DIGIT * 6}.bin"))
        if not sweeps:
            return frames
        last = max(sweeps)
        most = _MAX_SHARDS * len(sweeps)
        return _planned(frames, int(last.stem), last, most=most)

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
            FileError: A sweep lies far beyond anything that earlier runs can have begun.
        """
        last_of: dict[Path, Path] = {}
        for folder in (self.root / DATE).glob(f"{DATE}_drive_{_DIGIT * 4}_sync"):
            sweeps = (folder / "velodyne_points" / "data").glob(f"{_DIGIT * 10}.bin")
            mine = [sweep for sweep in sweeps if int(sweep.stem) < self.sequence_length]
            if mine:
                last_of[folder] = max(mine)
        if not last_of:
            return frames
        folder = max(last_of)
        drive, last = int(folder.name.split("_")[-2]), last_of[folder]
        index = drive * self.sequence_length + int(last.stem)
        most = _MAX_SHARDS * len(last_of) * self.sequence_length
        return _planned(frames, index, last, most=most)

    def drives(self, frames: int) -> Iterator[tuple[int, int]]:
        """Yield each drive and its number of frames, the last one possibly shorter."""
        for first in range(0, frames, self.sequence_length):
            yield first // self.sequence_length, min(self.sequence_length, frames - first)

    def write_calibration(self, calibration: CalibrationMatrices) -> None:
        """Write the day's calibration."""
        cameras, lidar = raw_calibration_texts(calibration)
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


def _planned(frames: int, index: int, sweep: Path, *, most: int) -> int:
    """Compute the number of frames up to `index`, the last sweep's, or `frames` if it is larger."""
    if index >= max(frames, most):
        raise FileError(
            sweep,
            f"is the sweep of frame {index}, expected none from {max(frames, most)} on beside so "
            "few others",
            f"move it away, or ask for {index + 1} frames",
        )
    return max(frames, index + 1)


Layout = ObjectLayout | DriveLayout

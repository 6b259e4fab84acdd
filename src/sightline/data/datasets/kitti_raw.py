"""Data set of a raw drive: consecutive frames of one recording."""

from collections.abc import Sequence
from copy import deepcopy
from pathlib import Path

import torch
from torch.utils.data import Dataset

from sightline.data.checks.drive_calibration import unread_calibration
from sightline.data.checks.entry_checks import select_spread
from sightline.data.checks.guessed_size import warn_of_guessed_size
from sightline.data.checks.lidar_mount import drive_pose_doubts, pose_of_tree, warn_of_mount
from sightline.data.formats.image_header import read_image_size
from sightline.data.formats.kitti_calibration import read_drive_pose, read_raw_matrices
from sightline.data.formats.kitti_files import read_image, read_points, read_raw_calibration
from sightline.data.layouts.drive_poses import list_oxts, read_oxts_poses, read_poses
from sightline.data.layouts.drive_times import drive_times, drive_times_doubts
from sightline.data.layouts.frame_lists import GapsError
from sightline.data.layouts.kitti_trees import (
    RAW_CALIBRATION,
    DriveFiles,
    DriveFrame,
    describe_absent,
    list_drive,
)
from sightline.files.problem import FileError
from sightline.files.shard_path import data_path
from sightline.geometry.arguments import sample_index
from sightline.geometry.calibration import centred_image_size
from sightline.geometry.road_height import LidarPose
from sightline.geometry.user_warning import warn_user
from sightline.jobs.worker import keep_opencv_to_one_thread_in_workers
from sightline.structures.level import level_from_mount
from sightline.structures.sample import CameraLidarSample


class KittiRawDrive(Dataset[CameraLidarSample]):
    """Frames of one drive at 10 Hz, in the official layout or the flat one.

    `list_drive` documents both layouts. Calibration, poses and times are read once. A rotated,
    tilted, higher or lower LiDAR is handled as in `KittiObjectDataset`.
    """

    def __init__(
        self,
        folder: Path | str,
        poses: Path | str | None = None,
        *,
        allow_gaps: bool = False,
    ) -> None:
        """List the files and read the short ones.

        Args:
            folder: Folder of the drive, e.g. `2011_09_26/2011_09_26_drive_0052_sync`.
            poses: File of `world_from_lidar`, one line of 12 numbers for each frame (3x4, row by
                row), in order; or "oxts", to compute them from the drive's GPS and IMU readings.
            allow_gaps: Whether a frame may lack its image or its sweep, which is then None: some
                published drives miss a few sweeps. If there is no image at all, the principal point
                is assumed to be the centre of the image.

        Raises:
            ValueError: There are no frames or no calibration, frames lack a part, or the poses or
                times do not fit the frames.
        """
        self.folder = data_path(folder)
        files = list_drive(self.folder)
        if not files.frames or files.calibration is None:
            lacking = "frames" if not files.frames else "calib_cam_to_cam.txt"
            raise ValueError(
                f"{self.folder} holds no {lacking}, expected a raw drive: image_02/data, "
                "velodyne_points/data, and the calibration there or one folder up; give the "
                "folder of one drive"
            )
        if not allow_gaps:
            _check_complete(self.folder, files)
        self.frames = files.frames
        self.calibration_folder = files.calibration
        self.matrices = read_raw_matrices(files.calibration)
        self.calibration = read_raw_calibration(files.calibration)
        """Calibration of every frame."""
        self._stated_pose = read_drive_pose(files.calibration)
        self.take_pose(self.estimate_pose(files.frames))
        if self._stated_pose is None:
            warn_of_mount(self._pose, files.frames, self.folder)
        for difference in drive_pose_doubts(files.frames, self._stated_pose):
            warn_user(f"{files.calibration / RAW_CALIBRATION[1]}: {difference}")
        self._times = drive_times(files)
        doubts = unread_calibration(self.folder, files.calibration)
        doubts += [] if self._times is None else drive_times_doubts(files, self._times)
        for doubt in doubts:
            warn_user(str(doubt))
        self._poses = None if poses is None else _poses(files, poses, self._times)
        self.first_image = files.first_image
        warn_of_guessed_size(files.frames, self.matrices, self.folder)
        self.image_size = (
            centred_image_size(self.calibration.image_from_camera)
            if self.first_image is None
            else read_image_size(self.first_image)
        )

    def pose_places(self, num_frames: int) -> Sequence[int]:
        """See `PosedDataset`."""
        return select_spread(range(num_frames))

    def estimate_pose(self, frames: Sequence[DriveFrame]) -> LidarPose:
        """See `PosedDataset`; a mount in the calibration goes before an estimate."""
        return self._stated_pose or pose_of_tree(frames)

    def take_pose(self, pose: LidarPose) -> None:
        """See `PosedDataset`."""
        self._pose = pose
        self._level_from_lidar = level_from_mount(self.calibration, pose.tilt)

    @property
    def sample_ids(self) -> tuple[str, ...]:
        """Names of the frames as in the file names, e.g. "0000000005", in order."""
        return tuple(frame.sample_id for frame in self.frames)

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.frames)

    def time_s(self, index: int) -> float | None:
        """Time of a frame's sweep since the drive's first [s]; None: there are no times."""
        return None if self._times is None else self._times[index]

    def __getitem__(self, index: int) -> CameraLidarSample:
        """Read a frame.

        Raises:
            IndexError: There is no such frame.
            ValueError: A file is invalid, or the size of its image differs from the drive's first;
                the error names it.
        """
        keep_opencv_to_one_thread_in_workers()
        index = sample_index(index, len(self))
        frame = self.frames[index]
        image = None if frame.image is None else read_image(frame.image)
        if frame.image and image is not None and image.shape[1:] != self.image_size:
            raise FileError(
                frame.image,
                f"is {image.shape[1]}x{image.shape[2]} (height x width), expected "
                f"{self.image_size[0]}x{self.image_size[1]} like the drive's first image",
                "extract the drive again",
            )
        # Copies: changing a sample must not change the frames that follow.
        pose = None if self._poses is None else self._poses[index].clone()
        calibration, level_from_lidar = deepcopy((self.calibration, self._level_from_lidar))
        return CameraLidarSample(
            sample_id=frame.sample_id,
            calibration=calibration,
            image_size=self.image_size,
            image=image,
            points=None if frame.points is None else read_points(frame.points),
            world_from_lidar=pose,
            timestamp_s=self.time_s(index),
            lidar_height_m=self._pose.height_m,
            level_from_lidar=level_from_lidar,
        )


def _check_complete(folder: Path, files: DriveFiles) -> None:
    for part, name in (("image", "image_02"), ("points", "velodyne_points")):
        absent = [frame.sample_id for frame in files.frames if getattr(frame, part) is None]
        if absent:
            raise GapsError(
                f"{folder} is incomplete: {name} lacks {len(absent)} of {len(files.frames)} frames "
                f"({describe_absent(absent)})",
                "extract the drive again, or name a list of the complete frames",
            )


def _poses(files: DriveFiles, poses: Path | str, times: Sequence[float] | None) -> torch.Tensor:
    if poses != "oxts":
        read = read_poses(poses)
        if len(read) != len(files.frames):
            raise FileError(
                poses,
                f"holds {len(read)} poses, expected one for each of the {len(files.frames)} frames",
                "name the poses of this drive",
            )
        return torch.from_numpy(read)
    assert files.calibration is not None, "a drive without a calibration was refused"
    mounting = files.calibration / RAW_CALIBRATION[2]
    return torch.from_numpy(read_oxts_poses(list_oxts(files), mounting, times))

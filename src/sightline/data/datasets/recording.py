"""Data set of a recording: images and clouds in folders, with their calibration."""

from collections.abc import Collection, Sequence
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass
from decimal import Decimal
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float64, UInt8
from torch import Tensor
from torch.utils.data import Dataset

from sightline.data.checks.calibration_judge import CalibrationJudge
from sightline.data.checks.entry_checks import select_spread
from sightline.data.checks.frame_checks import Findings
from sightline.data.checks.guessed_size import recording_size_doubt
from sightline.data.checks.lidar_mount import (
    describe_unknown_tilt,
    has_points,
    mount_doubts_of_recording,
    pose_of_recording,
    select_road_clouds,
)
from sightline.data.checks.recording_checks import (
    CALIBRATION_REMEDY,
    calibration_problems,
    examine_recording_frame,
    first_complete_frame,
    reference_images,
    size_mismatch,
    view_of_drive,
)
from sightline.data.formats.image_file import read_rgb
from sightline.data.formats.image_header import read_image_size
from sightline.data.formats.kitti_calibration import check_matrices
from sightline.data.formats.kitti_conversion import labels_from_kitti
from sightline.data.formats.kitti_files import read_depth
from sightline.data.formats.kitti_labels import read_labels
from sightline.data.formats.point_files import read_cloud
from sightline.data.formats.recording_calibration import (
    RecordingCalibration,
    read_recording_calibration,
    require_usable,
)
from sightline.data.formats.rings import covers_turn
from sightline.data.formats.undistortion import undistort
from sightline.data.layouts.frame_lists import GapsError, read_sample_list
from sightline.data.layouts.kitti_trees import (
    NO_LABELS_REMEDY,
    ObjectFrame,
    Part,
    describe_absent,
    remedy_for_absent,
)
from sightline.data.layouts.recording_files import (
    list_recording,
    no_frames,
    order_doubt,
    read_times,
    times_doubts,
    unpaired,
    unused_files,
)
from sightline.files.problem import FileError, read_or_note
from sightline.files.shard_path import data_path, is_single_shard
from sightline.geometry.arguments import sample_index
from sightline.geometry.calibration import Calibration, centred_image_size
from sightline.geometry.kitti_mount import KITTI_LIDAR_HEIGHT_M
from sightline.geometry.road_height import LidarPose, describe_odd_height
from sightline.geometry.tilt import Tilt
from sightline.geometry.user_warning import warn_user
from sightline.jobs.worker import keep_opencv_to_one_thread_in_workers
from sightline.structures.level import level_calibration, level_from_mount, mounted_labels
from sightline.structures.sample import CameraLidarSample

_REMEDY = "see docs/recordings.md for the layout"


class RecordingDataset(Dataset[CameraLidarSample]):
    """Frames of a recording, by name; `list_recording` documents its files.

    Image sizes and numbers of beams may differ between frames. Images of a distorting lens are
    undistorted when they are read. Clouds stay in the LiDAR's own frame; if it is rotated (the
    camera points more than 5 degrees away from its x axis) or tilted (by 3 degrees or more against
    the road in some clouds), samples have a `level_from_lidar`. Warns once, with the likely cause,
    if the mounting in the calibration is implausible, if a tilt is found, and if the height above
    the road has to be assumed.
    """

    def __init__(
        self,
        folder: Path | str,
        *,
        sample_list: str | Path | Sequence[str] | None = None,
        parts: Collection[Part] = ("image", "points", "objects"),
        needs: Collection[Part] | None = None,
    ) -> None:
        """List the files.

        Args:
            folder: Folder of the recording.
            sample_list: List of the frames; see `read_sample_list`. None: all.
            parts: Parts to load.
            needs: Parts that no frame may lack. None: all.

        Raises:
            ValueError: There are no frames, the list names absent ones, or a frame lacks a part or
                a calibration.
        """
        self.folder = data_path(folder)
        self.parts = frozenset(parts)
        files = list_recording(self.folder)
        if not files.frames:
            nothing = no_frames(self.folder)
            raise FileError(nothing.path, nothing.problem, nothing.remedy)
        known = {frame.sample_id: frame for frame in files.frames}
        selected = tuple(known)
        if sample_list is not None:
            selected = read_sample_list(sample_list, self.folder)
        absent = [name for name in selected if name not in known]
        if absent:
            raise ValueError(
                f"{self.folder} has no frame {describe_absent(absent)}: "
                f"{remedy_for_absent(absent, tuple(known))}"
            )
        self._all_frames = files.frames
        self.frames = tuple(known[name] for name in selected)
        self._warn_of_unused(files.frames)
        self._check_complete(self.parts if needs is None else self.parts & set(needs))
        pictures = (frame.image or frame.depth for frame in files.frames)
        self._any_picture = next((path for path in pictures if path is not None), None)
        guessed = None
        if self._any_picture is None:
            guessed = recording_size_doubt(select_spread(self.frames))
        if guessed is not None:
            warn_user(str(guessed))
        self._reference_images = reference_images(files.frames)
        self._times: dict[str, Decimal] = {}
        if files.times is not None:
            self._times = read_times(files.times)
            for doubt in times_doubts(files.times, self._times, tuple(known)):
                warn_user(str(doubt))
        is_part = files.times is not None and is_single_shard(files.times)  # with all times
        starts = (time for name, time in self._times.items() if is_part or name in known)
        self._start_s = min(starts, default=Decimal(0))
        self._last_rig: tuple[Path, tuple[int, int], _Rig] | None = None
        self._judge = CalibrationJudge()
        self._warn_of_rig()
        misnamed = unpaired(self.folder, files.frames)
        if misnamed is not None and {"image", "points"} <= self.parts:
            warn_user(str(misnamed))

    @property
    def sample_ids(self) -> tuple[str, ...]:
        """Names of the frames as in the file names, in order."""
        return tuple(frame.sample_id for frame in self.frames)

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.frames)

    @property
    def all_sample_ids(self) -> tuple[str, ...]:
        """Names of all frames, also of those that the list leaves out."""
        return tuple(frame.sample_id for frame in self._all_frames)

    def time_s(self, index: int) -> float | None:
        """Time of a frame since the recording's start [s]; None: unknown."""
        name = self.frames[index].sample_id
        return float(self._times[name] - self._start_s) if name in self._times else None

    def label_file(self, index: int) -> Path | None:
        """Path of the frame's labels; None: no labels, or they are not loaded."""
        return self.frames[index].objects if "objects" in self.parts else None

    def examine(self, frame: ObjectFrame) -> Findings:
        """Examine labels and depth of a frame; its calibration is checked when it is opened.

        Raises:
            FileError: The lens of the calibration folds the picture.
        """
        assert frame.calibration is not None, f"{frame.sample_id} passed without a calibration"
        reference = self._reference_images[frame.calibration]
        size = read_or_note(read_image_size, reference, [])
        contents = read_or_note(read_recording_calibration, frame.calibration, [])
        if contents is not None:
            try:
                require_usable(contents, size)
            except ValueError as error:
                raise FileError(frame.calibration, str(error), _REMEDY) from error
        found = examine_recording_frame(frame, reference=reference)
        own = (frame.objects, frame.depth)
        found.implausible = [each for each in found.implausible if each.path in own]
        return found

    def __getitem__(self, index: int) -> CameraLidarSample:
        """Read a frame.

        Raises:
            IndexError: There is no such frame.
            ValueError: A file is invalid; the error names it.
        """
        keep_opencv_to_one_thread_in_workers()
        index = sample_index(index, len(self))
        frame = self.frames[index]
        path = frame.calibration
        assert path is not None, f"{frame.sample_id} passed without a calibration"
        rig = self._rig(path)
        contents = rig.contents
        # Copies: changing a sample must not change the frames that follow.
        calibration, level_from_lidar = deepcopy((rig.calibration, rig.level_from_lidar))
        picture = frame.image or frame.depth
        size = read_or_note(read_image_size, picture, [])  # also where pictures are not needed
        if picture is not None and size is not None:
            mismatch = size_mismatch(picture, size, contents, self._reference_images[path])
            if mismatch is not None:
                raise FileError(mismatch.path, mismatch.problem, mismatch.remedy)
        image = None
        if frame.image is not None and "image" in self.parts:
            image = _undistorted_image(frame.image, contents)
        seen = (size if frame.image else None) or contents.image_size
        self._judge.judge(
            contents.matrices.stacked, seen, lambda: calibration_problems(contents, seen, path)
        )
        points = None
        if frame.points is not None and "points" in self.parts:
            points = torch.from_numpy(read_cloud(frame.points, contents.max_intensity))
        objects = None
        if frame.objects is not None and "objects" in self.parts:
            level = level_calibration(calibration, level_from_lidar)
            objects = labels_from_kitti(read_labels(frame.objects), level)
            objects = mounted_labels(objects, level_from_lidar)
        try:
            return CameraLidarSample(
                sample_id=frame.sample_id,
                calibration=calibration,
                image_size=self._image_size(frame, image, contents, calibration),
                image=image,
                points=points,
                objects=objects,
                depth=read_depth(frame.depth) if frame.depth and "depth" in self.parts else None,
                timestamp_s=self.time_s(index),
                lidar_height_m=self._lidar_height_m(contents),
                level_from_lidar=level_from_lidar,
                all_around=points is not None and covers_turn(points.numpy()),
            )
        except FileError:
            raise
        except ValueError as error:
            raise FileError(self.folder, str(error), _REMEDY) from error

    def _rig(self, path: Path) -> "_Rig":
        """Read a calibration; a file for all frames is read once, unless it has changed."""
        stamp = (0, 0)
        with suppress(OSError):  # reading tells
            status = path.stat()
            stamp = status.st_mtime_ns, status.st_size
        if self._last_rig is None or self._last_rig[:2] != (path, stamp):
            contents = read_recording_calibration(path)
            tilt = self._pose.tilt if contents.lidar_tilt is None else contents.lidar_tilt
            self._last_rig = (path, stamp, _Rig.of(contents, tilt))
        return self._last_rig[2]

    def _lidar_height_m(self, contents: RecordingCalibration) -> float | None:
        """Height of the LiDAR, also for a frame without a sweep; estimated if sweeps are used."""
        if contents.lidar_height_m is not None:
            return contents.lidar_height_m
        return self._pose.height_m if "points" in self.parts else None

    @cached_property
    def _pose(self) -> LidarPose:
        """Pose of the LiDAR, from the road and the first calibration."""
        return self.estimate_pose(self._all_frames)

    def pose_places(self, num_frames: int) -> Sequence[int]:
        """See `PosedDataset`."""
        return select_road_clouds(range(num_frames))

    def estimate_pose(self, frames: Sequence[ObjectFrame]) -> LidarPose:
        """See `PosedDataset`."""
        first = first_complete_frame(frames)
        path = None if first is None else first.calibration
        return pose_of_recording(frames, read_or_note(read_recording_calibration, path, []))

    def take_pose(self, pose: LidarPose) -> None:
        """See `PosedDataset`."""
        self._pose, self._last_rig = pose, None

    def _warn_of_unused(self, frames: Sequence[ObjectFrame]) -> None:
        order = order_doubt(self.folder, frames)
        if order is not None:
            warn_user(str(order))
        for part, unused in unused_files(self.folder, frames):
            if part in self.parts or part == "calibration":
                warn_user(str(unused))

    def _warn_of_rig(self) -> None:
        first = first_complete_frame(self.frames)
        view = view_of_drive(self.frames)
        path = None if first is None else first.calibration
        contents = read_or_note(read_recording_calibration, path, [])
        if first is not None and contents is not None:
            self._judge.skip(contents.matrices.stacked, _seen_size(first, contents))
        if view is not None and view.doubt is not None:
            warn_user(str(view.doubt))
            return
        if first is not None and contents is not None and path is not None:
            size = _seen_size(first, contents)
            doubts = check_matrices(
                contents.matrices, size, path, tilt=contents.lidar_tilt, remedy=CALIBRATION_REMEDY
            )
            for doubt in doubts:
                warn_user(str(doubt))
        if "points" in self.parts:
            self._warn_of_pose()

    def _warn_of_pose(self) -> None:
        first = first_complete_frame(self.frames)
        path = None if first is None else first.calibration
        contents = read_or_note(read_recording_calibration, path, [])
        if contents is None:
            return
        tilt = self._pose.tilt
        if contents.lidar_tilt is None and tilt is not None:
            warn_user(
                f"{path}: the road in its clouds shows that the LiDAR is tilted, {tilt}: "
                "detectors get levelled clouds; give lidar_tilt_deg (docs/recordings.md)",
            )
        doubts = mount_doubts_of_recording(self._all_frames, contents)
        unknown = describe_unknown_tilt(self._all_frames, contents, self._pose)
        for doubt in (*doubts, *unknown):
            warn_user(f"{path}: {doubt}")
        height_m = self._lidar_height_m(contents)
        if (
            height_m is not None
            and contents.lidar_height_m is None
            and describe_odd_height(height_m)
        ):
            warn_user(
                f"{path}: the road in its clouds shows that the LiDAR is {height_m:.2f} m above it"
                f"{describe_odd_height(height_m)}",
            )
        if height_m is None and has_points(self._all_frames):
            warn_user(
                f"{path}: the clouds show too little of the road to find the LiDAR's height above "
                f"it: KITTI's {KITTI_LIDAR_HEIGHT_M} m is assumed; give lidar_height_m",
            )

    def _image_size(
        self,
        frame: ObjectFrame,
        image: UInt8[Tensor, "3 height width"] | None,
        contents: RecordingCalibration,
        calibration: Calibration,
    ) -> tuple[int, int]:
        if image is not None:
            return image.shape[1], image.shape[2]
        picture = frame.image or frame.depth
        if picture is not None:
            return read_image_size(picture)
        if contents.image_size is not None:
            return contents.image_size
        if self._any_picture is not None:
            return read_image_size(self._any_picture)
        return centred_image_size(calibration.image_from_camera)

    def _check_complete(self, needed: Collection[Part]) -> None:
        attributes = {"image": "images", "points": "points", "objects": "labels", "depth": "depth"}
        for part in ("calibration", *(part for part in attributes if part in needed)):
            absent = [each.sample_id for each in self.frames if getattr(each, part) is None]
            if absent:
                some_labelled = part == "objects" and len(absent) < len(self.frames)
                further = f", or {NO_LABELS_REMEDY}" if some_labelled else ""
                raise GapsError(
                    f"{self.folder} lacks {attributes.get(part, part)} of {len(absent)} of "
                    f"{len(self.frames)} frames ({describe_absent(absent)})",
                    f"add them or name a list of the complete frames{further}",
                )


def _seen_size(frame: ObjectFrame, contents: RecordingCalibration) -> tuple[int, int] | None:
    """Height, width [px] by a frame's image or its calibration; None: neither has it."""
    return read_or_note(read_image_size, frame.image, []) or contents.image_size


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Rig:
    """Mounted camera and LiDAR."""

    contents: RecordingCalibration
    calibration: Calibration
    level_from_lidar: Float64[Tensor, "4 4"] | None
    """Rotation to the level frame; see `CameraLidarSample`."""

    @classmethod
    def of(cls, contents: RecordingCalibration, tilt: Tilt | None) -> "_Rig":
        """Create the rig of a calibration file with the tilt of its LiDAR."""
        calibration = Calibration(
            image_from_camera=torch.from_numpy(contents.matrices.image_from_camera),
            camera_from_lidar=torch.from_numpy(contents.matrices.camera_from_lidar),
        )
        return cls(
            contents=contents,
            calibration=calibration,
            level_from_lidar=level_from_mount(calibration, tilt),
        )


def _undistorted_image(
    path: Path, contents: RecordingCalibration
) -> UInt8[Tensor, "3 height width"]:
    image = read_rgb(path)
    if contents.lens is not None:
        camera_matrix = contents.matrices.image_from_camera[:, :3]
        try:
            image = undistort(
                image, camera_matrix, contents.lens.coefficients, model=contents.lens.model
            )
        except ValueError as error:  # the lens does not fit pictures of this size
            problem, _, remedy = f"cannot be undistorted: {error}".partition("; ")
            raise FileError(path, problem, remedy or _REMEDY) from error
    return torch.from_numpy(np.ascontiguousarray(image.transpose(2, 0, 1)))

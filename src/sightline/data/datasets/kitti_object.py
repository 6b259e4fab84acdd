"""Data set of the object benchmark: single frames with image, sweep, calibration and labels."""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Literal

from torch.utils.data import Dataset

from sightline.data.checks.calibration_judge import CalibrationJudge
from sightline.data.checks.entry_checks import select_spread
from sightline.data.checks.guessed_size import warn_of_guessed_size
from sightline.data.checks.lidar_mount import pose_of_tree, stated_mount_doubts, warn_of_mount
from sightline.data.formats.image_header import read_image_size
from sightline.data.formats.kitti_calibration import (
    check_matrices,
    read_object_matrices,
    read_object_pose,
)
from sightline.data.formats.kitti_conversion import labels_from_kitti
from sightline.data.formats.kitti_files import calibration_of, read_depth, read_image, read_points
from sightline.data.formats.kitti_labels import read_labels
from sightline.data.layouts.frame_lists import GapsError, doubt_about_names, read_sample_list
from sightline.data.layouts.kitti_trees import (
    NO_LABELS_REMEDY,
    ObjectFrame,
    Part,
    Velodyne,
    describe_absent,
    list_object_frames,
    named_in_two_ways,
    part_folder,
    remedy_for_absent,
    shared_calibration_remedy,
)
from sightline.files.problem import FileError, read_or_note
from sightline.files.shard_path import data_path
from sightline.geometry.arguments import sample_index
from sightline.geometry.calibration import centred_image_size
from sightline.geometry.road_height import LidarPose
from sightline.geometry.user_warning import warn_user
from sightline.jobs.worker import keep_opencv_to_one_thread_in_workers
from sightline.structures.level import level_calibration, level_from_mount, mounted_labels
from sightline.structures.sample import CameraLidarSample


class KittiObjectDataset(Dataset[CameraLidarSample]):
    """Frames of KITTI's object tree, in the order of their list.

    `root`/training or `root`/testing holds `image_2`, `velodyne` (or `velodyne_reduced`), `calib`
    and, for training, `label_2`. The files are listed once, so that gaps are found at the start and
    not in the middle of a training; their contents are read frame by frame. If the LiDAR is rotated
    (the camera points more than 5 degrees away from its x axis) or tilted (by 4 degrees or more
    against the road in some clouds, with a warning), samples have a `level_from_lidar`. If it sits
    more than 0.5 m higher or lower than KITTI's, with a warning, they have its height. Calibration
    files of simulated rigs give height and tilt, frame by frame, which then replace estimates; so
    does the record of the sound tree's pose that `sightline corrupt` leaves in its trees.
    """

    def __init__(
        self,
        root: Path | str,
        split: Literal["training", "testing"] = "training",
        *,
        sample_list: str | Path | Sequence[str] | None = None,
        velodyne: Velodyne = "velodyne",
        parts: Collection[Part] = ("image", "points", "objects"),
        needs: Collection[Part] | None = None,
    ) -> None:
        """List the files.

        Args:
            root: Folder with `training` and `testing`.
            split: Split of the frames. Testing has no labels: its samples' `objects` are None.
            sample_list: List of the frames; see `read_sample_list`. None: all frames with any file.
            velodyne: Folder of the sweeps; KITTI tools keep sweeps cropped to the image's view
                apart.
            parts: Parts to load. Calibrations and the sizes of images are always read; for
                simulations without a camera leave out "image": the depth maps define the size.
            needs: Parts that no frame may lack; other parts are optional. None: all. A frame
                without a picture has the size of the others; if there is no picture at all, the
                principal point is assumed to be the centre.

        Raises:
            ValueError: There are no frames, the list names absent ones, or a frame lacks a part.
        """
        self.root = data_path(root)
        self.split = split
        self.velodyne = velodyne
        self.parts = frozenset(parts) - ({"objects"} if split == "testing" else set())
        folder = self.root / split
        has_images, has_depth = (
            (folder / part_folder(each)).is_dir() for each in ("image", "depth")
        )
        sized: Part = "image" if has_images or "image" in self.parts or not has_depth else "depth"
        listed: tuple[Part, ...] = (sized, "calibration")
        listed += tuple(part for part in ("points", "objects", "depth") if part in self.parts)
        needed: tuple[Part, ...] = listed
        found = list_object_frames(folder, listed, velodyne)
        if needs is not None:
            _warn_of_stray_labels(folder, found)
            needed = ("calibration", *(part for part in listed if part in needs))
            # Calibrations and labels alone are no frame: some users extract too many of them.
            found = {name: frame for name, frame in found.items() if _has_sensor(frame)}
        if not found:
            folders = ", ".join(f"{split}/{part_folder(part, velodyne)}" for part in needed)
            raise ValueError(
                f"{self.root} holds no frames of KITTI's object tree, expected files in {folders}; "
                f"give the folder that has {split}/ in it"
            )
        requested = (
            tuple(found) if sample_list is None else read_sample_list(sample_list, self.root)
        )
        _check_complete(folder, requested, found, needed, velodyne)
        self.frames = tuple(found[frame_id] for frame_id in requested)
        self.all_sample_ids = tuple(found)
        """Names of all frames of the split, also of those that the list leaves out."""
        pictures = (frame.image or frame.depth for frame in found.values())
        self._any_picture = next((path for path in pictures if path is not None), None)
        self._judge = CalibrationJudge()
        for frame in select_spread(self.frames):
            matrices = read_or_note(read_object_matrices, frame.calibration, [])
            if matrices is not None:
                size = read_or_note(read_image_size, self._sized(frame), [])
                self._judge.skip(matrices.stacked, size)
        if self._any_picture is None:
            first = next((frame.calibration for frame in self.frames if frame.calibration), None)
            matrices = read_or_note(read_object_matrices, first, [])
            warn_of_guessed_size(self.frames, matrices, folder)
        self._pose = pose_of_tree(tuple(found.values()))
        warn_of_mount(self._pose, tuple(found.values()), folder)
        for doubt in stated_mount_doubts(self.frames):
            warn_user(f"{part_folder('calibration')} of {folder}: {doubt}")

    @property
    def pose(self) -> LidarPose:
        """Pose of the LiDAR over the road in frames whose calibration file does not give it."""
        return self._pose

    def pose_places(self, num_frames: int) -> Sequence[int]:
        """See `PosedDataset`."""
        return select_spread(range(num_frames))

    def estimate_pose(self, frames: Sequence[ObjectFrame]) -> LidarPose:
        """See `PosedDataset`."""
        return pose_of_tree(frames)

    def take_pose(self, pose: LidarPose) -> None:
        """See `PosedDataset`."""
        self._pose = pose

    @property
    def sample_ids(self) -> tuple[str, ...]:
        """Names of the frames, e.g. "000042", in order."""
        return tuple(frame.sample_id for frame in self.frames)

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.frames)

    def label_file(self, index: int) -> Path | None:
        """Path of the frame's labels; None: no labels, or they are not loaded."""
        return self.frames[index].objects

    def __getitem__(self, index: int) -> CameraLidarSample:
        """Read a frame.

        Raises:
            IndexError: There is no such frame.
            ValueError: A file is invalid; the error names it.
        """
        keep_opencv_to_one_thread_in_workers()
        index = sample_index(index, len(self))
        frame = self.frames[index]
        sized, path = self._sized(frame), frame.calibration
        assert path is not None, f"{frame.sample_id} passed without a calibration"
        matrices = read_object_matrices(path)
        calibration = calibration_of(matrices, path)
        pose = read_object_pose(path) or self._pose
        level_from_lidar = level_from_mount(calibration, pose.tilt)
        objects = None
        if frame.objects is not None:
            level = level_calibration(calibration, level_from_lidar)
            objects = labels_from_kitti(read_labels(frame.objects), level)
            objects = mounted_labels(objects, level_from_lidar)
        image = read_image(frame.image) if frame.image and "image" in self.parts else None
        if image is not None:
            height, width = image.shape[1:]
        elif sized is not None:
            height, width = read_image_size(sized)
        else:
            height, width = centred_image_size(calibration.image_from_camera)
        seen = None if sized is None else (height, width)
        self._judge.judge(
            matrices.stacked,
            seen,
            lambda: check_matrices(matrices, seen, path, tilt=pose.tilt, picture=frame.image),
        )
        depth = read_depth(frame.depth) if frame.depth and "depth" in self.parts else None
        if frame.depth is not None and depth is not None and depth.shape != (height, width):
            raise FileError(
                frame.depth,
                f"is {depth.shape[0]}x{depth.shape[1]} (height x width), expected {height}x{width} "
                f"like {sized}",
                "create both again",
            )
        return CameraLidarSample(
            sample_id=frame.sample_id,
            calibration=calibration,
            image_size=(height, width),
            image=image,
            points=None if frame.points is None else read_points(frame.points),
            objects=objects,
            depth=depth,
            lidar_height_m=pose.height_m,
            level_from_lidar=level_from_lidar,
        )

    def _sized(self, frame: ObjectFrame) -> Path | None:
        """Picture that defines the image's size."""
        return frame.image or frame.depth or self._any_picture


def _has_sensor(frame: ObjectFrame) -> bool:
    return any(each is not None for each in (frame.image, frame.points, frame.depth))


def _warn_of_stray_labels(folder: Path, found: Mapping[str, ObjectFrame]) -> None:
    """Warn of labels that belong to no frame, unless every frame has some: names that differ."""
    frames = {name: frame for name, frame in found.items() if _has_sensor(frame)}
    unlabelled = [name for name, frame in frames.items() if frame.objects is None]
    stray = [name for name, frame in found.items() if frame.objects and name not in frames]
    if not stray or not unlabelled:
        return
    warn_user(
        f"{folder / part_folder('objects')}: has {len(stray):,} files that belong to no frame "
        f"({describe_absent(stray)}), and {len(unlabelled):,} of {len(frames):,} frames have no "
        f"labels ({describe_absent(unlabelled)}); give labels the names of their images and "
        "sweeps, or move them away",
    )


def _check_complete(
    folder: Path,
    requested: Sequence[str],
    found: Mapping[str, ObjectFrame],
    needed: Sequence[Part],
    velodyne: Velodyne,
) -> None:
    absent = [frame_id for frame_id in requested if frame_id not in found]
    if len(absent) == len(requested):
        raise ValueError(
            f"{folder} has no frame {describe_absent(absent)}: "
            f"{remedy_for_absent(absent, tuple(found))}"
        )
    gaps = [("every part", absent)] if absent else []
    for part in needed:
        lacking = [
            frame_id
            for frame_id in requested
            if frame_id in found and getattr(found[frame_id], part) is None
        ]
        if lacking:
            gaps.append((part_folder(part, velodyne), lacking))
    renamed = named_in_two_ways(folder, found.values(), velodyne) if gaps else None
    if renamed is not None:
        raise FileError(renamed.path, renamed.problem, renamed.remedy)
    if gaps:
        described = ", ".join(
            f"{part} of {len(frame_ids)} of {len(requested)} frames ({describe_absent(frame_ids)})"
            for part, frame_ids in gaps
        )
        remedy = shared_calibration_remedy(folder) or (
            "extract the missing archives or give a list of the complete frames"
        )
        if 0 < len(dict(gaps).get(part_folder("objects"), ())) < len(requested):
            remedy += f", or {NO_LABELS_REMEDY}"
        raise GapsError(f"{folder} lacks {described}", doubt_about_names(absent) or remedy)

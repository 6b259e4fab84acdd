"""Opening of data sets, whose type is recognised by the folder's contents."""

import warnings
from collections.abc import Collection, Sequence
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Any, Protocol, get_args, runtime_checkable

from torch.utils.data import Dataset

from sightline.data.drive_calibration import drive_matrices_doubts
from sightline.data.entry_checks import (
    check_sample_frames,
    is_corrupted,
    warn_of_unread_files,
)
from sightline.data.frame_checks import (
    Findings,
    examine_depth_frame,
    examine_drive_frame,
    examine_object_frame,
)
from sightline.data.frame_lists import read_sample_list
from sightline.data.kitti_depth import KittiDepthDataset
from sightline.data.kitti_object import KittiObjectDataset
from sightline.data.kitti_raw import KittiRawDrive
from sightline.data.kitti_trees import (
    DepthFrame,
    DriveSplit,
    ObjectFrame,
    Part,
    SelectedSplit,
    Velodyne,
    describe_absent,
    describe_raw_drives,
    find_velodyne,
    list_drive,
    list_drive_frames,
    list_object_frames,
    list_selected_frames,
    remedy_for_absent,
)
from sightline.data.other_layouts import no_data_set, refuse_other_layouts
from sightline.data.point_files import holds_no_point
from sightline.data.recording import RecordingDataset
from sightline.data.recording_files import is_recording
from sightline.data.unread_files import (
    depth_folders,
    drive_folders,
    object_folders,
    recording_folders,
)
from sightline.files.plain_text import shortened
from sightline.files.problem import FileError
from sightline.files.safe_names import unusable_names
from sightline.files.shard_path import data_path
from sightline.geometry.arguments import plain_names, plain_path, sample_index
from sightline.geometry.wrong_types import named_arguments
from sightline.jobs.output_dirs import KITTI_SPLITS, data_name
from sightline.structures.sample import UNNAMED, CameraLidarSample

_DRIVE_SPLITS: tuple[DriveSplit, ...] = ("val", "train")
_SENSOR_NOUNS: dict[Part, str] = {"image": "images", "points": "point clouds"}


@runtime_checkable  # for beartype, which checks arguments under pytest
class SampleDataset(Protocol):
    """Data set with named samples."""

    @property
    def sample_ids(self) -> tuple[str, ...]:
        """Names of the samples, in order; each occurs once."""

    def __len__(self) -> int:
        """Number of samples."""

    def __getitem__(self, index: int) -> CameraLidarSample:
        """Read a sample."""


@runtime_checkable
class ExaminedDataset(SampleDataset, Protocol):
    """Data set that lists the files of its samples, and examines them without a sample."""

    @property
    def frames(self) -> Sequence[ObjectFrame]:
        """Files of the samples, in the order of `sample_ids`."""

    def examine(self, frame: ObjectFrame) -> Findings:
        """Find the faults of a frame's files."""


class NamedSubset(Dataset[CameraLidarSample]):
    """Subset of a data set by names, in their order; its samples have these names."""

    def __init__(self, dataset: SampleDataset, sample_ids: Sequence[str]) -> None:
        """Look up the names.

        Raises:
            ValueError: The data set lacks some of them, or gives a name twice.
        """
        names = dataset.sample_ids
        positions = {name: index for index, name in enumerate(names)}
        if len(positions) < len(names):
            twice = next(name for index, name in enumerate(names) if positions[name] != index)
            raise ValueError(
                f"{type(dataset).__name__}.sample_ids holds '{shortened(twice)}' twice, expected a "
                "different name for each sample; rename one of them"
            )
        absent = [name for name in sample_ids if name not in positions]
        if absent:
            raise ValueError(
                f"the data lacks {len(absent)} of the requested frames, {describe_absent(absent)}: "
                f"{remedy_for_absent(absent, dataset.sample_ids)}"
            )
        self.dataset = dataset
        self.sample_ids = tuple(sample_ids)
        self.positions = tuple(positions[name] for name in sample_ids)

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.positions)

    def __getitem__(self, index: int) -> CameraLidarSample:
        """Read a sample.

        Raises:
            IndexError: There is no such sample.
            ValueError: The sample has a name other than in `sample_ids`, or see the data set.
        """
        index = sample_index(index, len(self))
        sample, name = self.dataset[self.positions[index]], self.sample_ids[index]
        if sample.sample_id == UNNAMED:
            return replace(sample, sample_id=name)
        if sample.sample_id != name:
            raise ValueError(
                f"{type(self.dataset).__name__}: sample {self.positions[index]} is named "
                f"'{shortened(sample.sample_id)}', expected '{shortened(name)}' as in sample_ids; "
                "give the sample this sample_id, or none"
            )
        return sample


@named_arguments
def open_dataset(
    path: Path | str,
    *,
    sample_list: str | Path | Sequence[str] | None = None,
    velodyne: Velodyne | None = None,
    parts: Collection[Part] | None = None,
    needs: Collection[Part] | None = None,
) -> SampleDataset:
    """Open a recording, KITTI's object tree, depth tree or raw drive, depending on `path`.

    From a tree of several splits it opens `training`, or in a depth tree the first existing one of
    the cropped selection, `val`, anonymous test frames and `train`; give the folder of another
    split to open it.

    Examples:
        >>> import sightline
        >>> from sightline.simulation.packaged import PACKAGED_FRAMES
        >>> dataset = sightline.open_dataset(PACKAGED_FRAMES)
        >>> dataset.sample_ids, dataset[0].image_size
        (('000000', '000001'), (375, 1242))

    Args:
        path: Folder of the recording, the tree, one of its splits, or the drive.
        sample_list: List of the samples; see `read_sample_list`. None: all.
        velodyne: The sweeps' folder in an object tree. None: velodyne, or else velodyne_reduced.
        parts: Parts to load; images may be loaded additionally. None: image, points and objects, if
            they exist.
        needs: Parts that no frame may lack. None: all named parts.

    The first frame and two more are checked by the rules of `sightline check`: doubtful values, and
    ignored files of other formats, give a warning.

    Raises:
        TypeError: `path` is no path, or the parts are no names.
        ValueError: `path` is no data set, or lacks files; there are no such parts; a used folder
            contains only files of other formats; a sweep is not in metres, or has reflectances
            outside 0 to 1.
    """
    path = existing_folder(path)
    parts = None if parts is None else plain_names("parts", parts, get_args(Part))
    needs = None if needs is None else plain_names("needs", needs, get_args(Part))
    requested: Collection[Part] = ("image", "points", "objects") if parts is None else parts
    if parts is None and needs is None:
        needs = ()
    allow_gaps = needs is not None and not {"image", "points"} <= set(needs)
    path = _resolve_split(path)
    dataset: SampleDataset | None
    if is_recording(path):
        warn_of_unread_files(recording_folders(path), {*requested, "calibration"})
        dataset = RecordingDataset(path, sample_list=sample_list, parts=requested, needs=needs)
    else:
        dataset = _open_object_tree(path, sample_list, velodyne, requested, needs)
    if dataset is None:
        refuse_other_layouts(path)
        is_drive = list_drive(path).calibration is not None  # one with a folder image_2, perhaps
        has_parts = bool(list_object_frames(path, ("image", "points")))
        if has_parts and (path / "image_2").is_dir() and not is_drive:
            raise FileError(
                path,
                "holds the parts of an object split",
                "rename it to training or testing, as in KITTI's tree",
            )
        dataset = _open_depth_tree(
            path, load_images="image" in requested, allow_gaps=allow_gaps
        ) or _open_drive(path, requested, allow_gaps=allow_gaps)
        if dataset is not None and sample_list is not None:
            dataset = NamedSubset(dataset, read_sample_list(sample_list, path))
        elif isinstance(dataset, ExaminedDataset):  # a class that may leave samples unnamed
            dataset = NamedSubset(dataset, dataset.sample_ids)
    if dataset is None:
        raise _no_data_set(path)
    if velodyne not in (None, sweeps_folder(dataset)):
        raise ValueError(
            f"{path}: {velodyne} is a folder of KITTI's object trees, and this is none; leave "
            "velodyne out"
        )
    _check_gaps(dataset, path, needs or ())
    _check_samples(dataset, path, requested)
    return dataset


def existing_folder(path: Path | str) -> Path:
    """Folder of a data set, or its shards as one; its contents stay unread.

    Raises:
        TypeError: `path` is no path.
        ValueError: It does not exist, or is no folder.
    """
    folder = data_path(plain_path("path", path, "the folder of a data set; give its name"))
    if not folder.is_dir():
        raise _no_data_set(folder)
    return folder


def _open_object_tree(
    path: Path,
    sample_list: str | Path | Sequence[str] | None,
    velodyne: Velodyne | None,
    parts: Collection[Part],
    needs: Collection[Part] | None,
) -> KittiObjectDataset | None:
    root = path.parent if path.name in KITTI_SPLITS else path
    for split in KITTI_SPLITS if root == path else (path.name,):
        sweeps = velodyne or find_velodyne(root / split)
        if not list_object_frames(root / split, ("image", "points"), sweeps):
            continue
        if root == path and sample_list is None:
            _warn_of_other_split(root, split)
        read = {*parts, "calibration", "image"}  # images' sizes are always read
        warn_of_unread_files(object_folders(root / split, sweeps), read)
        return KittiObjectDataset(
            root,
            "training" if split == "training" else "testing",
            sample_list=sample_list,
            velodyne=sweeps,
            parts=parts,
            needs=needs,
        )
    return None


def _warn_of_other_split(root: Path, used: str) -> None:
    """Warn of frames in the split of a tree that is not opened."""
    for split in KITTI_SPLITS:
        if split != used and (found := list_object_frames(root / split, ("image", "points"))):
            warnings.warn(
                f"{root}: only the frames in {used} are used, not the {len(found):,} in {split}; "
                f"give {root / split} for those",
                stacklevel=4,
            )


def _check_gaps(dataset: SampleDataset, path: Path, needs: Collection[Part]) -> None:
    """Refuse frames without a needed sensor, where the data set itself allows gaps.

    Raises:
        ValueError: A frame has no file of the sensor.
    """
    if refuses_gaps(dataset):
        return
    for part in [each for each in _SENSOR_NOUNS if each in needs]:
        lacking = [
            name
            for index, name in enumerate(dataset.sample_ids)
            if not has_file(dataset, index, part)
        ]
        if lacking:
            raise ValueError(
                f"{path} lacks {_SENSOR_NOUNS[part]} of {len(lacking)} of {len(dataset)} frames "
                f"({describe_absent(lacking)}); add them or name a list of the complete frames"
            )


def _check_samples(dataset: SampleDataset, path: Path, parts: Collection[Part]) -> None:
    """Check some frames by the rules of `check`, before any work on them."""
    misnamed = unusable_names(path, dataset.sample_ids)
    if misnamed is not None:
        raise FileError(misnamed.path, misnamed.problem, misnamed.remedy)
    whole = dataset.dataset if isinstance(dataset, NamedSubset) else dataset
    chosen = dataset.positions if isinstance(dataset, NamedSubset) else range(len(dataset))
    if isinstance(whole, KittiObjectDataset):
        check_sample_frames(path, whole.frames, examine_object_frame, parts)
    elif isinstance(whole, ExaminedDataset):
        listed = [whole.frames[place] for place in chosen]
        check_sample_frames(path, listed, whole.examine, parts)
    elif isinstance(whole, KittiDepthDataset):
        frames = [whole.frames[place] for place in chosen]
        check_sample_frames(path, frames, examine_depth_frame, parts)
    elif isinstance(whole, KittiRawDrive):
        moments = [whole.frames[place] for place in chosen]
        examine = partial(examine_drive_frame, matrices=whole.matrices)
        shared = drive_matrices_doubts(whole.matrices, whole.calibration_folder, whole.first_image)
        check_sample_frames(path, moments, examine, parts, shared=shared)


def has_file(dataset: SampleDataset, index: int, part: Part) -> bool:
    """Whether a data set of `open_dataset` has a file for a part of a sample; reads none."""
    return _listed_file(dataset, index, part) is not None


def _listed_file(dataset: SampleDataset, index: int, part: Part) -> Path | None:
    if isinstance(dataset, NamedSubset):
        return _listed_file(dataset.dataset, dataset.positions[index], part)
    assert isinstance(
        dataset, ExaminedDataset | KittiObjectDataset | KittiDepthDataset | KittiRawDrive
    ), f"{type(dataset).__name__} lists no files: it needs `frames` and `examine`"
    frame = dataset.frames[index]
    in_frame = "sparse" if isinstance(frame, DepthFrame) and part == "points" else part
    return getattr(frame, in_frame, None)


def warn_of_missing_sensors(
    dataset: SampleDataset,
    path: Path,
    parts: Collection[Part],
    *,
    stacklevel: int,
    needs_sweeps: bool = True,
) -> None:
    """Warn of frames without data of a sensor that predictions use: the other one decides there.

    These are frames without its file, or whose point cloud holds no point (unless `sightline
    corrupt` made it). Sparse depth maps in place of whole sweeps that are there are told, too.

    Args:
        dataset: Data set of `open_dataset`.
        path: Its folder.
        parts: Used parts.
        stacklevel: See `warnings.warn`.
        needs_sweeps: Whether whole sweeps are better than sparse depth maps.
    """
    sparse_maps = describe_sparse_maps(dataset, path) if "points" in parts else None
    if needs_sweeps and sparse_maps is not None and describe_raw_drives(data_path(path)):
        warnings.warn(sparse_maps, stacklevel=stacklevel)
    effect, total = "there predictions go by the other sensor alone", f"{len(dataset):,} frames"
    for part in [each for each in _SENSOR_NOUNS if each in parts]:
        files = [_listed_file(dataset, index, part) for index in range(len(dataset))]
        lacking = [index for index, file in enumerate(files) if file is None]
        may_be_empty = part == "image" or is_corrupted(path)
        empty = [
            index
            for index, file in enumerate([] if may_be_empty else files)
            if file is not None and holds_no_point(file)
        ]
        if lacking:
            problem = f"there are no {_SENSOR_NOUNS[part]} for {len(lacking):,} of {total}"
            first = f"the first is {dataset.sample_ids[lacking[0]]}"
            remedy = "give them if there are any"
            warnings.warn(f"{path}: {problem}, {first}; {effect}; {remedy}", stacklevel=stacklevel)
        if empty:
            problem = f"the point clouds of {len(empty):,} of {total} hold no point"
            first = f"the first is {dataset.sample_ids[empty[0]]}"
            remedy = "check whether the LiDAR delivered points"
            warnings.warn(f"{path}: {problem}, {first}; {effect}; {remedy}", stacklevel=stacklevel)


def describe_sparse_maps(dataset: SampleDataset, path: Path) -> str | None:
    """Say that sparse depth maps are used as sweeps, and which raw drives have those; else None."""
    whole = dataset.dataset if isinstance(dataset, NamedSubset) else dataset
    if not isinstance(whole, KittiDepthDataset):
        return None
    said = f"{path} is a depth completion tree, whose sparse depth maps are used as sweeps"
    return "; ".join((said, *describe_raw_drives(data_path(path))))


def label_file(dataset: SampleDataset, index: int) -> Path | None:
    """Path of a sample's labels in KITTI's format; None: no labels, or they are not loaded."""
    if isinstance(dataset, NamedSubset):
        return label_file(dataset.dataset, dataset.positions[index])
    if isinstance(dataset, KittiObjectDataset | RecordingDataset):
        return dataset.label_file(index)
    return dataset.frames[index].objects if isinstance(dataset, ExaminedDataset) else None


def refuses_gaps(dataset: SampleDataset) -> bool:
    """Whether the data set was refused if one of its frames lacked a part in `needs`.

    The others find a missing file, other than an image or a sweep, only when they read the frame.
    """
    return isinstance(dataset, KittiObjectDataset | RecordingDataset)


def list_sample_files(dataset: SampleDataset) -> list[dict[str, Path]]:
    """List the existing files of each sample by part, loaded or not, in the order of the samples.

    The parts are images, sweeps, labels and calibrations, or all that the layout lists.
    """
    if isinstance(dataset, NamedSubset):
        listed = list_sample_files(dataset.dataset)
        return [listed[place] for place in dataset.positions]
    frames: Sequence[Any] = getattr(dataset, "frames", ())
    if isinstance(dataset, KittiObjectDataset):
        folder = dataset.root / dataset.split
        parts: tuple[Part, ...] = ("image", "points", "objects", "calibration")
        found = list_object_frames(folder, parts, dataset.velodyne)
        frames = [found[name] for name in dataset.sample_ids]
    return [
        {
            each.name: path
            for each in fields(frame)
            if isinstance(path := getattr(frame, each.name), Path)
        }
        for frame in frames
    ]


def dataset_title(dataset: SampleDataset, data: Path) -> str:
    """Name a data set at `data` in records: the same name for an object tree and for its split."""
    return data_name(dataset.root if isinstance(dataset, KittiObjectDataset) else data)


def sweeps_folder(dataset: SampleDataset) -> Velodyne:
    """Name of an object tree's folder of sweeps, for records; the default for other data."""
    return dataset.velodyne if isinstance(dataset, KittiObjectDataset) else "velodyne"


def _no_data_set(path: Path) -> FileError:
    problem = no_data_set(path)
    return FileError(problem.path, problem.problem, problem.remedy)


def _resolve_split(path: Path) -> Path:
    """Resolve a path that does not show the name of the split, such as "." or a link."""
    known = (*KITTI_SPLITS, *_DRIVE_SPLITS)
    resolved = path.resolve()
    return resolved if path.name not in known and resolved.name in known else path


def _open_depth_tree(path: Path, *, load_images: bool, allow_gaps: bool) -> SampleDataset | None:
    split = _find_depth_split(path)
    if split is None:
        return None
    root = path.parent if path.name == split and split in _DRIVE_SPLITS else path
    parts: tuple[Part, ...] = ("image", "points") if load_images else ("points",)
    warn_of_unread_files(depth_folders(root, split), parts)
    return KittiDepthDataset(root, split, load_images=load_images, allow_gaps=allow_gaps)


def _find_depth_split(path: Path) -> DriveSplit | SelectedSplit | None:
    if path.name in _DRIVE_SPLITS and any(path.glob("*/proj_depth")):
        return "train" if path.name == "train" else "val"
    if (path / "velodyne_raw").is_dir():
        is_validation = (path / "groundtruth_depth").is_dir()
        return "val_selection_cropped" if is_validation else "test_depth_completion_anonymous"
    if list_selected_frames(path, "val_selection_cropped"):
        return "val_selection_cropped"
    if list_drive_frames(path, "val", path, ("image_02",)):
        return "val"
    if list_selected_frames(path, "test_depth_completion_anonymous"):
        return "test_depth_completion_anonymous"
    return "train" if list_drive_frames(path, "train", path, ("image_02",)) else None


def _open_drive(path: Path, parts: Collection[Part], *, allow_gaps: bool) -> SampleDataset | None:
    if not list_drive(path).frames:
        return None
    warn_of_unread_files(drive_folders(path), parts)
    return KittiRawDrive(path, allow_gaps=allow_gaps)

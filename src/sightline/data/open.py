"""Opening of data sets, whose type is recognised by the folder's contents."""

from collections.abc import Collection, Sequence
from functools import partial
from pathlib import Path
from typing import get_args

from sightline.data.checks.drive_calibration import drive_matrices_doubts
from sightline.data.checks.entry_checks import (
    check_sample_frames,
    warn_of_unread_files,
)
from sightline.data.checks.frame_checks import (
    examine_depth_frame,
    examine_drive_frame,
    examine_object_frame,
)
from sightline.data.checks.other_layouts import misnamed_split, no_data_set, refuse_other_layouts
from sightline.data.checks.unread_files import (
    depth_folders,
    drive_folders,
    object_folders,
    recording_folders,
)
from sightline.data.datasets.kitti_depth import KittiDepthDataset
from sightline.data.datasets.kitti_object import KittiObjectDataset
from sightline.data.datasets.kitti_raw import KittiRawDrive
from sightline.data.datasets.recording import RecordingDataset
from sightline.data.datasets.sample_dataset import ExaminedDataset, NamedSubset, SampleDataset
from sightline.data.datasets.sample_files import SENSOR_NOUNS, has_file, refuses_gaps, sweeps_folder
from sightline.data.layouts.depth_trees import (
    DRIVE_SPLITS,
    OTHER_CAMERA,
    find_depth_split,
    split_by_drives,
    warn_of_other_camera,
    warn_of_other_splits,
)
from sightline.data.layouts.frame_lists import GapsError, read_sample_list
from sightline.data.layouts.kitti_trees import (
    Part,
    Velodyne,
    describe_absent,
    find_velodyne,
    list_drive,
    list_object_frames,
)
from sightline.data.layouts.recording_files import is_recording
from sightline.files.problem import FileError
from sightline.files.safe_names import unusable_names
from sightline.files.shard_checks import longer_tars
from sightline.files.shard_path import data_path
from sightline.geometry.arguments import plain_names, plain_path
from sightline.geometry.user_warning import warn_user
from sightline.geometry.wrong_types import named_arguments
from sightline.jobs.output_dirs import KITTI_SPLITS, is_split


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
    _warn_of_longer_tars(path)
    parts = None if parts is None else plain_names("parts", parts, get_args(Part))
    needs = None if needs is None else plain_names("needs", needs, get_args(Part))
    requested: Collection[Part] = ("image", "points", "objects") if parts is None else parts
    if parts is None and needs is None:
        needs = ()
    allow_gaps = needs is not None and not {"image", "points"} <= set(needs)
    path = resolve_split(path)
    dataset: SampleDataset | None
    if is_recording(path):
        warn_of_unread_files(recording_folders(path), {*requested, "calibration"})
        dataset = RecordingDataset(path, sample_list=sample_list, parts=requested, needs=needs)
    else:
        dataset = _open_object_tree(path, sample_list, velodyne, requested, needs)
    if dataset is None:
        refuse_other_layouts(path)
        misnamed = misnamed_split(path)
        if misnamed is not None:
            raise FileError(misnamed.path, misnamed.problem, misnamed.remedy)
        may_have_gaps = allow_gaps or sample_list is not None  # in frames that the list leaves out
        dataset = _open_depth_tree(
            path, load_images="image" in requested, allow_gaps=may_have_gaps
        ) or _open_drive(path, requested, allow_gaps=may_have_gaps)
        listed = (
            None if dataset is None or sample_list is None else read_sample_list(sample_list, path)
        )
        if isinstance(dataset, KittiDepthDataset):
            _warn_of_other_depth_frames(dataset, path, listed)
        if dataset is not None and listed is not None:
            needs = needs if allow_gaps else _complete_parts(dataset)
            dataset = NamedSubset(dataset, listed)
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


def _warn_of_longer_tars(path: Path) -> None:
    """Warn of shards that were appended to, or are of another packing than their indexes."""
    for problem in longer_tars(path):
        warn_user(str(problem))


def _open_object_tree(
    path: Path,
    sample_list: str | Path | Sequence[str] | None,
    velodyne: Velodyne | None,
    parts: Collection[Part],
    needs: Collection[Part] | None,
) -> KittiObjectDataset | None:
    root = path.parent if is_split(path) else path
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
            warn_user(
                f"{root}: only the frames in {used} are used, not the {len(found):,} in {split}; "
                f"give {root / split} for those",
            )


def _complete_parts(dataset: SampleDataset) -> tuple[Part, ...]:
    """List the parts that no frame of a raw drive or depth tree lacks if gaps are not allowed."""
    if not isinstance(dataset, KittiDepthDataset):
        return ("image", "points")
    has_truth = dataset.split != "test_depth_completion_anonymous"
    return (*(("image",) if dataset.load_images else ()), *(("depth",) if has_truth else ()))


def _check_gaps(dataset: SampleDataset, path: Path, needs: Collection[Part]) -> None:
    """Refuse frames without a needed sensor or true depth, where the data set itself allows gaps.

    Raises:
        ValueError: A frame has no file of it.
    """
    if refuses_gaps(dataset):
        return
    nouns: dict[Part, str] = {**SENSOR_NOUNS, "depth": "true depth"}
    for part in [each for each in nouns if each in needs]:
        lacking = [
            name
            for index, name in enumerate(dataset.sample_ids)
            if not has_file(dataset, index, part)
        ]
        if lacking:
            raise GapsError(
                f"{path} lacks {nouns[part]} of {len(lacking)} of {len(dataset)} frames "
                f"({describe_absent(lacking)})",
                "add them or name a list of the complete frames",
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


def _no_data_set(path: Path) -> FileError:
    problem = no_data_set(path)
    return FileError(problem.path, problem.problem, problem.remedy)


def resolve_split(path: Path) -> Path:
    """Resolve a path that does not show the name of the split, such as "." or a link."""
    known = (*KITTI_SPLITS, *DRIVE_SPLITS)
    resolved = path.resolve()
    return resolved if path.name not in known and resolved.name in known else path


def _open_depth_tree(path: Path, *, load_images: bool, allow_gaps: bool) -> SampleDataset | None:
    found = find_depth_split(path)
    if found is None:
        return None
    root, split = found
    parts: tuple[Part, ...] = ("image", "points") if load_images else ("points",)
    warn_of_unread_files(depth_folders(root, split), parts)
    return KittiDepthDataset(root, split, load_images=load_images, allow_gaps=allow_gaps)


def _warn_of_other_depth_frames(
    dataset: KittiDepthDataset, path: Path, listed: Sequence[str] | None
) -> None:
    """Warn of frames of a depth tree that are not opened, unless a list leaves them out."""
    if listed is None and split_by_drives(path) is None:
        warn_of_other_splits(dataset.root, dataset.split)
    if listed is None or any(name.endswith(OTHER_CAMERA) for name in listed):
        warn_of_other_camera(dataset.root, dataset.split)


def _open_drive(path: Path, parts: Collection[Part], *, allow_gaps: bool) -> SampleDataset | None:
    if not list_drive(path).frames:
        return None
    warn_of_unread_files(drive_folders(path), parts)
    return KittiRawDrive(path, allow_gaps=allow_gaps)

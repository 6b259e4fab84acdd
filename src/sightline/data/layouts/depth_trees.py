"""Splits of a KITTI depth completion tree: the opened one, the others, and their raw drives."""

from collections import Counter, defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from sightline.data.layouts.kitti_trees import (
    RAW_CALIBRATION,
    DepthFrame,
    DriveSplit,
    SelectedSplit,
    describe_absent,
    list_drive_frames,
    list_selected_frames,
    raw_images,
    selection_folder,
)
from sightline.files.problem import Problem
from sightline.geometry.user_warning import warn_user

DRIVE_SPLITS: Final[tuple[DriveSplit, ...]] = ("train", "val")
SELECTIONS: Final[tuple[SelectedSplit, ...]] = (
    "val_selection_cropped",
    "test_depth_completion_anonymous",
)
OTHER_CAMERA: Final = "image_03"
"""The right colour camera, whose frames `open_dataset` leaves out."""
_IN_PYTHON: Final = "KittiDepthDataset(.., split) reads those in Python"
_RAW_REMEDY: Final = (
    "extract KITTI's raw data, or link the folder of the day into the tree "
    "(in Python, KittiDepthDataset has raw_root)"
)


def split_by_drives(folder: Path) -> tuple[Path, DriveSplit] | None:
    """Root and split of a folder that is `train` or `val` of a depth tree; None: it is none."""
    place = folder if folder.name in DRIVE_SPLITS else folder.resolve()
    if place.name not in DRIVE_SPLITS or not any(place.glob("*/proj_depth")):
        return None
    return place.parent, "train" if place.name == "train" else "val"


def find_depth_split(path: Path) -> tuple[Path, DriveSplit | SelectedSplit] | None:
    """Root and split of a depth tree, or of one of its splits; None: it is none.

    Of several splits in a tree the first existing one of the cropped selection, `val`, anonymous
    test frames and `train` is found.
    """
    by_drives = split_by_drives(path)
    if by_drives is not None:
        return by_drives
    if (path / "velodyne_raw").is_dir():
        is_validation = (path / "groundtruth_depth").is_dir()
        return path, "val_selection_cropped" if is_validation else "test_depth_completion_anonymous"
    if list_selected_frames(path, "val_selection_cropped"):
        return path, "val_selection_cropped"
    if list_drive_frames(path, "val", path, ("image_02",)):
        return path, "val"
    if list_selected_frames(path, "test_depth_completion_anonymous"):
        return path, "test_depth_completion_anonymous"
    if list_drive_frames(path, "train", path, ("image_02",)):
        return path, "train"
    return None


def warn_of_other_splits(root: Path, used: DriveSplit | SelectedSplit) -> None:
    """Warn of frames in the splits of a depth tree that are not opened."""
    counts: dict[str, int] = {}
    folders: list[Path] = []
    for split in DRIVE_SPLITS:
        frames = list_drive_frames(root, split, root, ("image_02",)) if split != used else []
        if frames:
            counts[split] = len(frames)
            folders += [root / split] if split_by_drives(root / split) else []  # or in archives
    for selection in SELECTIONS:
        folder = selection_folder(root, selection)
        if selection != used and folder != root and folder.is_dir():
            counts[selection] = len(list_selected_frames(root, selection))
            folders.append(folder)
    if not counts:
        return
    others = ", ".join(f"{number:,} in {split}" for split, number in counts.items())
    remedy = f"give the folder of another split, such as {folders[0]}" if folders else _IN_PYTHON
    warn_user(
        f"{root}: only the frames in {used} are used, not the {others}; {remedy}",
    )


def warn_of_other_camera(root: Path, split: DriveSplit | SelectedSplit) -> None:
    """Warn of frames of the right camera in a split by drives, which are not opened."""
    if split == "train" or split == "val":  # mypy narrows by `==` only
        number = len(list_drive_frames(root, split, root, (OTHER_CAMERA,)))
        if number:
            warn_user(
                f"{root}: only the frames of image_02 in {split} are used, not the {number:,} of "
                f'{OTHER_CAMERA}; KittiDepthDataset(.., "{split}", cameras=("{OTHER_CAMERA}",)) '
                "reads those in Python",
            )


def raw_gaps(root: Path, split: DriveSplit, frames: Sequence[DepthFrame]) -> list[Problem]:
    """Problems of raw drives that lack intrinsics or images of a split's left camera."""
    by_folder: dict[Path, list[DepthFrame]] = defaultdict(list)
    for frame in frames:
        maps = frame.sparse or frame.truth
        if frame.camera != OTHER_CAMERA and maps is not None:
            by_folder[raw_images(root, maps.parents[3].name, "image_02")].append(frame)
    without_intrinsics: Counter[Path] = Counter()
    gaps = []
    for folder, of_drive in by_folder.items():
        absent = [frame.sample_id for frame in of_drive if frame.image is None]
        if of_drive[0].intrinsics is None:
            without_intrinsics[folder.parents[2] / RAW_CALIBRATION[0]] += len(of_drive)
        elif absent:
            problem = f"lacks images of {len(absent)} of {len(of_drive)} frames of {split} "
            problem += f"({describe_absent(absent)})"
            gaps.append(Problem(path=folder, problem=problem, remedy=_RAW_REMEDY))
    missing = [
        Problem(
            path=path,
            problem=f"is missing, with the intrinsics of {number:,} "
            f"{'frame' if number == 1 else 'frames'} of {split}",
            remedy=_RAW_REMEDY,
        )
        for path, number in without_intrinsics.items()
    ]
    return missing + gaps

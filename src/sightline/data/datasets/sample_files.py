"""Files of an open data set's samples, in any layout."""

import hashlib
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import fields
from itertools import product
from pathlib import Path
from typing import Any, Final, Literal, get_args

from sightline.data.checks.cut_sweeps import CUT_REMEDY, cut_sweeps
from sightline.data.checks.entry_checks import is_corrupted
from sightline.data.checks.frame_checks import is_blank_file
from sightline.data.datasets.kitti_depth import KittiDepthDataset
from sightline.data.datasets.kitti_object import KittiObjectDataset
from sightline.data.datasets.kitti_raw import KittiRawDrive
from sightline.data.datasets.recording import RecordingDataset
from sightline.data.datasets.sample_dataset import (
    ExaminedDataset,
    NamedSubset,
    SampleDataset,
    TimedDataset,
)
from sightline.data.formats.kitti_labels import MAX_LABEL_BYTES
from sightline.data.formats.point_files import holds_no_point
from sightline.data.formats.velodyne import hollow_file
from sightline.data.layouts.depth_trees import DRIVE_SPLITS
from sightline.data.layouts.kitti_trees import (
    DepthFrame,
    Part,
    Velodyne,
    describe_raw_drives,
    list_object_frames,
)
from sightline.files.plain_file import read_bytes
from sightline.files.plain_text import REMEDY
from sightline.files.shard_index import read_manifest
from sightline.files.shard_path import data_path, stored_file
from sightline.geometry.user_warning import warn_user
from sightline.jobs.output_dirs import data_name

SENSOR_NOUNS: Final[Mapping[Part, str]] = {"image": "images", "points": "point clouds"}
"""Nouns for the data of sensors."""
_Fault = Literal["absent", "empty", "useless", "cut"]
_FAULTS: Final[tuple[_Fault, ...]] = get_args(_Fault)
LABEL_DIGEST_DIGITS: Final = 16
"""Length of the digests of labels."""
_IN_DEPTH_FRAMES: Final[Mapping[Part, str]] = {"points": "sparse", "depth": "truth"}


def has_file(dataset: SampleDataset, index: int, part: Part) -> bool:
    """Test if a part of a sample has a file, without reading it."""
    return _listed_file(dataset, index, part) is not None


def sample_times(dataset: SampleDataset) -> Sequence[float | None] | None:
    """Times of all samples [s], without reading them; None: the layout keeps no times."""
    if isinstance(dataset, NamedSubset):
        times = sample_times(dataset.dataset)
        return None if times is None else [times[place] for place in dataset.positions]
    if not isinstance(dataset, TimedDataset):
        return None
    return [dataset.time_s(index) for index in range(len(dataset))]


def all_sample_ids(dataset: SampleDataset) -> tuple[str, ...]:
    """Names of all samples of a data set, also of those that a list leaves out."""
    if isinstance(dataset, NamedSubset):
        return tuple(dataset.dataset.sample_ids)
    if isinstance(dataset, KittiObjectDataset | RecordingDataset):
        return dataset.all_sample_ids
    return tuple(dataset.sample_ids)


def _listed_file(dataset: SampleDataset, index: int, part: Part) -> Path | None:
    if isinstance(dataset, NamedSubset):
        return _listed_file(dataset.dataset, dataset.positions[index], part)
    assert isinstance(
        dataset, ExaminedDataset | KittiObjectDataset | KittiDepthDataset | KittiRawDrive
    ), f"{type(dataset).__name__} lists no files: it needs `frames` and `examine`"
    frame = dataset.frames[index]
    in_frame = _IN_DEPTH_FRAMES.get(part, part) if isinstance(frame, DepthFrame) else part
    return getattr(frame, in_frame, None)


def warn_of_missing_sensors(
    dataset: SampleDataset,
    path: Path,
    parts: Collection[Part],
    *,
    needs_sweeps: bool = True,
) -> None:
    """Warn of frames without data of a sensor that predictions use: the other one decides there.

    These are frames without its file, or (unless `sightline corrupt` made them) whose point cloud
    holds no point, is doubtful, as a flat one, or was cut (.bin alone), or whose image has a single
    colour.
    Sparse depth maps in place of whole sweeps that are there are told, too.

    Args:
        dataset: Data set of `open_dataset`.
        path: Its folder.
        parts: Used parts.
        needs_sweeps: Whether whole sweeps are better than sparse depth maps.
    """
    sparse_maps = describe_sparse_maps(dataset, path) if "points" in parts else None
    if needs_sweeps and sparse_maps is not None and describe_raw_drives(data_path(path)):
        warn_user(sparse_maps)
    warn_of_missing_files([dataset], path, parts)


def warn_of_missing_files(
    datasets: Iterable[SampleDataset], path: Path, parts: Collection[Part]
) -> None:
    """Warn of frames without data of a sensor, as counted over all parts of a data set.

    Args:
        datasets: Parts of the data set, such as its shards; each is looked at once.
        path: Folder of the whole.
        parts: Used parts of frames.
    """
    used = [part for part in SENSOR_NOUNS if part in parts]
    may_be_empty = is_corrupted(path)
    num_frames, counts, firsts = 0, Counter[tuple[Part, _Fault]](), dict[tuple[Part, _Fault], str]()
    for dataset in datasets:
        num_frames += len(dataset)
        files = {part: _listed_files(dataset, part) for part in used}
        cut = () if may_be_empty else set(cut_sweeps(list(filter(None, files.get("points", ())))))
        for part, (index, name) in product(used, enumerate(dataset.sample_ids)):
            file = files[part][index]
            fault, details = _fault_of(file, part, may_be_empty=may_be_empty)
            if fault is None and file in cut:
                fault = "cut"
            if fault is not None:
                counts[part, fault] += 1
                firsts.setdefault((part, fault), name + details)
    for part, fault in product(used, _FAULTS):
        if not counts[part, fault]:
            continue
        share = f"{counts[part, fault]:,} of {num_frames:,} frames"
        problem, effect, remedy = (text.format(share) for text in _described(part, fault))
        first = f"the first is {firsts[part, fault]}"
        warn_user(f"{path}: {problem}, {first}; {effect}; {remedy}")


def _listed_files(dataset: SampleDataset, part: Part) -> list[Path | None]:
    return [_listed_file(dataset, index, part) for index in range(len(dataset))]


def _fault_of(file: Path | None, part: Part, *, may_be_empty: bool) -> tuple[_Fault | None, str]:
    """Find a missing file, or one whose data tell nothing, and its details; None: it has no fault.

    Files on a server are not read for data that are there but tell nothing.
    """
    if file is None:
        return "absent", ""
    if may_be_empty:
        return None, ""
    if part == "points" and holds_no_point(file):
        return "empty", ""
    if stored_file(file) is None:
        return None, ""
    if part == "image":
        return ("useless" if is_blank_file(file) else None), ""
    doubt = hollow_file(file) if file.suffix.lower() == ".bin" else None
    return (None, "") if doubt is None else ("useless", f", which {doubt}")


def _described(part: Part, fault: _Fault) -> tuple[str, str, str]:
    """Describe a fault of some frames: the problem with a place for their share, effect, remedy."""
    alone = "there predictions go by the other sensor alone"
    if fault == "absent":
        return f"there are no {SENSOR_NOUNS[part]} for {{}}", alone, "give them if there are any"
    if fault == "empty":
        remedy = "check whether the LiDAR delivered points"
        return "the point clouds of {} hold no point", alone, remedy
    if fault == "cut":
        effect = "each lacks the lowest rings of the others and ends at a block of the disk"
        return "the point clouds of {} were probably cut short by a copy", effect, CUT_REMEDY
    effect = "there they tell predictions nothing, or what is wrong"
    if part == "image":
        remedy = "check whether the camera delivered pictures"
        return "the images of {} have a single colour", effect, remedy
    remedy = "check the LiDAR's data and their conversion"
    return "the point clouds of {} are doubtful", effect, remedy


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


def digest_labels(dataset: SampleDataset) -> dict[str, str]:
    """Compute a digest of each frame's label file, by the frame's name; "" for no labels.

    Frames in shards on a server are left out, as each would be a request.

    Raises:
        FileError: A label file cannot be read.
    """
    files = {name: label_file(dataset, index) for index, name in enumerate(dataset.sample_ids)}
    return {
        name: "" if path is None else _digest_file(path)
        for name, path in files.items()
        if path is None or stored_file(path) is not None
    }


def _digest_file(path: Path) -> str:
    content = read_bytes(path, max_bytes=MAX_LABEL_BYTES, remedy=REMEDY)
    return hashlib.sha256(content).hexdigest()[:LABEL_DIGEST_DIGITS]


def refuses_gaps(dataset: SampleDataset) -> bool:
    """Test if `open_dataset` refuses data of this layout with a frame that lacks a part in `needs`.

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
    """Name a data set at `data` in records and claims.

    It is the same whether the tree or its opened split is given, and for shards of either. A split
    other than `training` is part of the name, as frames of two splits may have equal names.
    """
    whole = dataset.dataset if isinstance(dataset, NamedSubset) else dataset
    if isinstance(whole, KittiObjectDataset):
        name = data_name(_tree_of(data, whole.split))
        return name if whole.split == "training" else f"{name}/{whole.split}"
    if not isinstance(whole, KittiDepthDataset):
        return data_name(data)
    if whole.split in DRIVE_SPLITS:
        return f"{data_name(_tree_of(data, whole.split))}/{whole.split}"
    is_single = (whole.root / "velodyne_raw").is_dir()  # a selection in a folder of any name
    return data_name(data) if is_single else f"{data_name(data)}/{whole.split}"


def _tree_of(data: Path, split: str) -> Path:
    """Folder of the tree, or of its shards, of which `data` is the whole or a split."""
    if read_manifest(Path(str(data))) is not None or (data / split).is_dir():
        return data
    named = data if data.name == split else data.resolve()
    return named.parent if named.name == split else data


def sweeps_folder(dataset: SampleDataset) -> Velodyne:
    """Name of an object tree's folder of sweeps, for records; the default for other data."""
    return dataset.velodyne if isinstance(dataset, KittiObjectDataset) else "velodyne"

"""Warnings of kept results that are older than their frames, or of frames that are gone."""

from collections.abc import Collection, Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final

from sightline.data.datasets.kitti_raw import KittiRawDrive
from sightline.data.datasets.sample_dataset import NamedSubset, SampleDataset
from sightline.data.datasets.sample_files import all_sample_ids, list_sample_files
from sightline.data.layouts.frame_lists import is_note
from sightline.data.layouts.kitti_trees import Part, describe_absent
from sightline.files.shard_index import index_path
from sightline.files.shard_path import ShardPath, stored_file
from sightline.geometry.user_warning import warn_user

ADD_OVERWRITE: Final = "to make them anew, add --overwrite (overwrite=True)"
"""Remedy of a command that has this option."""

_IN_DEPTH_TREES = {"points": "sparse", "calibration": "intrinsics", "depth": "truth"}


def warn_of_newer_frames(
    dataset: SampleDataset,
    results: Iterable[tuple[int, Sequence[Path]]],
    *,
    parts: Collection[Part],
    remedy: str = ADD_OVERWRITE,
) -> None:
    """Warn if files of frames are newer than the kept results of the frames.

    By times of modification, so a change that keeps them is not noticed, and a copy of the data
    may be as sound as before. Files in shards have the time when their shard was packed; those on a
    server have none and are never newer.

    Args:
        dataset: Data set of `open_dataset`.
        results: Indices of frames, each with its kept results, if any.
        parts: Parts that results are made from, beside the calibration.
        remedy: Continuation of the warning.
    """
    names = {name for part in {*parts, "calibration"} for name in (part, _IN_DEPTH_TREES.get(part))}
    listed: list[dict[str, Path]] = []
    shared = shared_calibration(dataset)
    kept, older, first = 0, 0, None
    for index, paths in results:
        if not paths:
            continue
        kept += 1
        listed = listed or list_sample_files(dataset)
        inputs = [path for name, path in listed[index].items() if name in names] + shared
        if max(map(changed_at, inputs), default=0.0) > min(map(changed_at, paths)):
            older += 1
            first = first or paths[0]
    if first is not None:
        warn_user(
            f"{first.parent}: of {kept:,} frames whose results are kept, {older:,} changed after "
            f"the result, the first is {first.stem}: the data were changed, copied or packed "
            f"since; {remedy}",
        )


def warn_of_gone_frames(dataset: SampleDataset, folder: Path, names: Collection[str]) -> None:
    """Warn of results of frames that the whole data set does not have.

    Args:
        dataset: Data set of `open_dataset`.
        folder: Folder of the results.
        names: Names of the frames with results; notes and hidden files among them are left out.
    """
    kept = {name for name in names if not (is_note(name) or name.startswith("."))}
    gone = sorted(kept - set(all_sample_ids(dataset)))
    if gone:
        warn_user(
            f"{folder}: results of {len(gone):,} of {len(kept):,} frames, "
            f"{describe_absent(gone)}, are of no frame of these data and stay; if the frames "
            "were removed or renamed, remove their results, too, or name another folder",
        )


def shared_calibration(dataset: SampleDataset) -> list[Path]:
    """List the calibration files of a raw drive, which all its frames share; empty: no such."""
    whole = dataset.dataset if isinstance(dataset, NamedSubset) else dataset
    if not isinstance(whole, KittiRawDrive):
        return []
    return [
        whole.calibration_folder / f"calib_{name}.txt" for name in ("cam_to_cam", "velo_to_cam")
    ]


def changed_at(path: Path) -> float:
    """Time of modification [s], of a file in shards that of packing; 0: removed, or on a server."""
    stored = stored_file(path)
    with suppress(OSError):
        if stored is not None:
            file = index_path(stored) if isinstance(path, ShardPath) else stored
            return float(file.stat().st_mtime)
    return 0.0

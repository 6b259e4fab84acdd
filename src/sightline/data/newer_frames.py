"""Warning of results that are older than the frames that they were made from."""

import warnings
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from sightline.data.kitti_trees import Part
from sightline.data.open import SampleDataset, list_sample_files

_IN_DEPTH_TREES = {"points": "sparse", "calibration": "intrinsics", "depth": "truth"}


def warn_of_newer_frames(
    dataset: SampleDataset,
    results: Mapping[int, Sequence[Path]],
    *,
    parts: Collection[Part],
    remedy: str = "to make them anew, add --overwrite",
) -> None:
    """Warn if files of frames are newer than the kept results of the frames.

    By times of modification, so a change that keeps them is not noticed, and a copy of the data
    may be as sound as before. Files in shards have no times and are never newer.

    Args:
        dataset: Data set of `open_dataset`.
        results: Kept results by the index of their frame, none for some.
        parts: Parts that results are made from, beside the calibration.
        remedy: Continuation of the warning.
    """
    kept = {index: paths for index, paths in results.items() if paths}
    if not kept:
        return
    listed = list_sample_files(dataset)
    names = {name for part in {*parts, "calibration"} for name in (part, _IN_DEPTH_TREES.get(part))}
    newer = []
    for index, paths in kept.items():
        inputs = [path for name, path in listed[index].items() if name in names]
        if max(map(_changed_at, inputs), default=0) > min(map(_changed_at, paths)):
            newer.append(index)
    if newer:
        first = kept[newer[0]][0]
        warnings.warn(
            f"{first.parent}: of {len(kept):,} frames whose results are kept, {len(newer):,} "
            f"have files newer than the result, the first is {first.stem}: the data were changed "
            f"or copied since; {remedy}",
            stacklevel=3,
        )


def _changed_at(path: Path) -> int:
    """Time of modification [ns]; 0: in shards, or removed meanwhile."""
    with suppress(OSError):
        return path.stat().st_mtime_ns
    return 0

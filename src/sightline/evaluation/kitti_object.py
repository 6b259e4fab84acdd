"""KITTI's object evaluation of a folder of result files: the official figures, exactly.

2D boxes, orientation, bird's-eye view and 3D; Car, Pedestrian, Cyclist; easy, moderate, hard.
"""

import itertools
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TypeVar

from sightline.data.kitti_labels import KittiObjects, read_labels, read_results
from sightline.data.progress import track
from sightline.data.sample_list import read_sample_list
from sightline.evaluation.kitti_object_pairs import MatchingData, concatenate, find_pairs
from sightline.evaluation.kitti_object_rules import STRICT, MinimumOverlaps
from sightline.evaluation.kitti_object_scores import score_objects
from sightline.evaluation.object_report import ObjectReport

_FRAMES_AT_A_TIME = 64

Item = TypeVar("Item")


def evaluate_objects(
    results_dir: Path,
    labels_dir: Path,
    *,
    split: Path | str | None = None,
    overlaps: MinimumOverlaps = STRICT,
    bootstrap: int = 0,
    seed: int = 0,
    progress: bool = False,
) -> ObjectReport:
    """Evaluates result files against label files as KITTI's official program does.

    Frames are read and dropped one after the other; what is kept grows with the scores.

    Args:
        results_dir: One file a frame, 16 fields a line; empty where nothing was found.
        labels_dir: One file a frame, 15 fields a line.
        split: Text file with the frames to evaluate, one a line, or the name of a list as
            `read_sample_list` takes it; None: all frames that have labels.
        overlaps: What a match must exceed, by class and metric.
        bootstrap: Resamples of the frames for `AP_all_points`; 0 leaves it out.
        seed: Of the resamples.
        progress: Whether to show how far it is.

    Raises:
        ValueError: If a frame lacks its file (KITTI's program would skip it, which flatters the
            recall), or a file is at fault; the message names it and says what to do.
    """
    if bootstrap < 0:
        raise ValueError(f"bootstrap must not be negative, got {bootstrap}: give 0 to leave it out")
    if seed < 0:
        raise ValueError(f"seed must not be negative, got {seed}: give 0 or more")
    minima = overlaps.as_array()
    frames = read_frames(results_dir, labels_dir, split, progress=progress)
    parts: list[MatchingData] = []
    for batch in _batches(frames):
        detections, labels = zip(*batch, strict=True)
        parts.append(find_pairs(detections, labels, minima))
    return score_objects(concatenate(parts), overlaps, bootstrap=bootstrap, seed=seed)


def read_frames(
    results_dir: Path, labels_dir: Path, split: Path | str | None, *, progress: bool
) -> Iterator[tuple[KittiObjects, KittiObjects]]:
    """Reads results and labels frame by frame; the missing files are found before the first.

    Raises:
        ValueError: If a frame lacks a file, or a file is at fault.
    """
    names = _frame_names(labels_dir, split)
    _require_files(
        labels_dir,
        names,
        "label",
        "extract the labels again, or leave the frames out of the split file",
    )
    _require_files(
        results_dir,
        names,
        "result",
        "write an empty one where nothing was found, or name the frames to score in a split file",
    )
    shown: Iterable[str] = track(names, description="reading results") if progress else names
    return (
        (read_results(results_dir / f"{name}.txt"), read_labels(labels_dir / f"{name}.txt"))
        for name in shown
    )


def _frame_names(labels_dir: Path, split: Path | str | None) -> Sequence[str]:
    if split is not None:
        return read_sample_list(split, labels_dir.absolute().parent.parent)
    names = sorted(path.stem for path in labels_dir.glob("*.txt"))
    if not names:
        raise ValueError(f"{labels_dir} has no label files (*.txt); give KITTI's folder label_2")
    return names


def _require_files(folder: Path, names: Sequence[str], kind: str, remedy: str) -> None:
    if not folder.is_dir():
        raise ValueError(f"{folder} is no folder; give the one that holds the {kind} files")
    present = {path.name for path in folder.iterdir()}
    missing = [name for name in names if f"{name}.txt" not in present]
    if missing:
        raise ValueError(
            f"{folder} has no {kind} file for {len(missing):,} of {len(names):,} frames, the first "
            f"of them {missing[0]}.txt: {remedy}"
        )


def _batches(items: Iterable[Item]) -> Iterator[list[Item]]:
    iterator = iter(items)
    while batch := list(itertools.islice(iterator, _FRAMES_AT_A_TIME)):
        yield batch

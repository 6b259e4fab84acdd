"""Looks a whole data set through for what would stop a job in the middle, or spoil it unseen."""

import os
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice
from pathlib import Path

from sightline.data.problem import Problem
from sightline.data.progress import track
from sightline.data.tree_checks import Check, TreeSummary, find_trees


def summarize_tree(root: Path | str) -> tuple[TreeSummary, ...]:
    """What a folder holds, from the files' names alone; empty where it is no KITTI tree."""
    return tuple(tree.summary for tree in find_trees(Path(root)))


def check_tree(root: Path | str, *, num_workers: int | None = None) -> Iterator[Problem]:
    """Reads every file of a KITTI tree and tells of each fault, frame by frame in order.

    Known are the object tree (`training`, `testing`, or one of these folders itself), the depth
    completion benchmark's and a raw drive. Missing, truncated, non-finite and implausible files
    are found, and files of one frame that do not fit each other. Never stops at the first fault,
    and holds only a few frames in memory. An empty sweep is no fault.

    Args:
        root: The data set's folder.
        num_workers: Threads that read; None: one a core.

    Raises:
        ValueError: `num_workers` is not positive.
    """
    if num_workers is not None and num_workers < 1:
        raise ValueError(f"workers must be at least 1, got {num_workers}")
    root = Path(root)
    trees = find_trees(root)
    if not trees:
        yield Problem(
            path=root,
            problem="holds no frames of KITTI's object tree (training/image_2), depth tree "
            "(val_selection_cropped/image) or raw drive (image_02/data)"
            if root.is_dir()
            else "is no folder",
            remedy="give the folder that the archives were extracted to",
        )
    for tree in trees:
        yield from tree.gaps
        answers = _answers(tree.checks, num_workers or os.cpu_count() or 1)
        description = f"checking {tree.summary.folder.name}"
        for problems in track(answers, description=description, total=len(tree.checks)):
            yield from problems


def _answers(checks: Iterable[Check], num_workers: int) -> Iterator[list[Problem]]:
    """The checks' answers in order; only a few checks run ahead of whoever asks."""
    waiting: deque[Future[list[Problem]]] = deque()
    remaining = iter(checks)
    with ThreadPoolExecutor(num_workers) as pool:
        try:
            waiting.extend(pool.submit(check) for check in islice(remaining, 4 * num_workers))
            while waiting:
                yield waiting.popleft().result()
                waiting.extend(pool.submit(check) for check in islice(remaining, 1))
        finally:
            for future in waiting:
                future.cancel()

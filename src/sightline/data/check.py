"""Check of a whole data set for faults that would stop a job or silently spoil its results."""

import os
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from sightline.data.checks.other_layouts import no_data_set
from sightline.data.checks.tree_checks import Check, TreeSummary, find_trees
from sightline.files.problem import GIVE_ACCESS, Problem
from sightline.files.shard_checks import longer_tars, shared_problem
from sightline.files.shard_path import data_path
from sightline.geometry.wrong_types import named_arguments
from sightline.jobs.progress import track
from sightline.jobs.read_ahead import check_threads, map_ahead


def summarize_tree(root: Path | str) -> tuple[TreeSummary, ...]:
    """Summarize a folder from its file names; empty if it is no data set.

    The cloud of a recording's first frame is read for the share of its points inside the image.
    """
    return tuple(tree.summary for tree in find_trees(data_path(root)))


@named_arguments
def check_tree(root: Path | str, *, num_workers: int | None = None) -> Iterator[Problem]:
    """Read every file of a data set and yield each fault, frame by frame in order.

    Supports recordings and KITTI's trees: the object tree (`training`, `testing`, or one of these
    folders itself), the depth completion tree and raw drives. Finds missing, truncated, non-finite
    and implausible files, files of one frame that do not fit each other, frames with equal files,
    and, with labels, clouds that are moved, turned, scaled or mirrored. Continues after faults, and
    holds only a few frames in memory. An empty sweep is no fault, unless all are.

    Examples:
        >>> import sightline
        >>> from sightline.simulation.packaged import PACKAGED_FRAMES
        >>> list(sightline.check_tree(PACKAGED_FRAMES))
        []

    Args:
        root: The data set's folder.
        num_workers: Number of reading threads; None: one per core.

    Raises:
        ValueError: `num_workers` is out of range.
    """
    workers = (os.cpu_count() or 1) if num_workers is None else num_workers
    check_threads(workers)
    root = data_path(root)
    damage = shared_problem(root)
    if damage is not None:
        yield damage
    yield from longer_tars(root)
    trees = find_trees(root)
    if not trees:
        yield no_data_set(root)
    told: set[Problem] = set()  # by splits of one root, or by the files' names
    for tree in trees:
        yield from (gap for gap in tree.gaps if gap not in told)
        told.update(tree.gaps)
        run = partial(_run, folder=tree.summary.folder)
        results = map_ahead(run, tree.checks, workers=workers)
        description = f"checking {tree.summary.folder.name}"
        for problems in track(results, description=description, total=len(tree.checks)):
            yield from (each for each in problems if each not in told)


def _run(check: Check, *, folder: Path) -> list[Problem]:
    """Run a check; a file that crashes a reader must not prevent the check of the others.

    Readers raise a `FileError` for foreseen faults, which the check itself converts to a problem.
    """
    try:
        return check.run()
    except OSError as error:  # a broken disk, or a damaged shard
        place = folder if error.filename is None else Path(os.fsdecode(error.filename))
        problem = f"{check.subject} cannot be checked: {error.strerror or error}"
        is_closed = isinstance(error, PermissionError)
        remedy = GIVE_ACCESS if is_closed else "copy or extract the file again"
        return [Problem(path=place, problem=problem, remedy=remedy)]
    except Exception as error:  # noqa: BLE001 - any exception becomes a problem
        cause = f"{type(error).__name__}: {error}".rstrip(": ")
        problem = f"{check.subject} cannot be checked ({cause})"
        return [Problem(path=folder, problem=problem, remedy="report this as a bug")]

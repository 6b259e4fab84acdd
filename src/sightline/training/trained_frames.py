"""Frames of a run, which checkpoints record by number and names."""

import hashlib
import warnings
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import cache
from itertools import chain, product
from pathlib import Path
from typing import Any, Final

from sightline.data.datasets.sample_dataset import SampleDataset
from sightline.data.datasets.sample_files import digest_labels
from sightline.data.layouts.kitti_trees import Part
from sightline.training.sources import SourceConfig, data_tree, open_source

FramesByTree = dict[Path, set[str]]
"""Names of frames by folder."""

_ANY_ORDER: Final = "training_frames_in_any_order"
"""Key of the digest that does not depend on the order of the folders; older states lack it."""
_DIVIDED_LISTS: Final = ("train", "val")
"""Lists that depend on the uses of a folder, where it has none."""
_MAX_TRIED_TREES: Final = 6
"""Largest number of folders of which every combination of uses is tried."""


def frames_in(frames_by_tree: FramesByTree, tree: Path) -> set[str]:
    """Collect the names of a tree's frames; a folder of shards and each of its tars are one."""

    def store(path: Path) -> Path:
        return path.parent if path.suffix == ".tar" else path

    found = (ids for each, ids in frames_by_tree.items() if store(each) == store(tree))
    return set(chain.from_iterable(found))


def frames_state(frames_by_tree: FramesByTree) -> dict[str, Any]:
    """Compute the number of frames and digests of their names, without their folders.

    One digest is for the folders in order, which tells equal names of two folders apart, one for
    any order.
    """
    names = [sorted(ids) for ids in frames_by_tree.values()]
    return {
        "num_training_frames": sum(map(len, names)),
        "training_frames": _digest([*chain(*names)]),
        _ANY_ORDER: _digest([*chain(*sorted(names))]),
    }


def validation_state(datasets: Sequence[SampleDataset]) -> dict[str, Any]:
    """Compute the number of validation frames, and digests of their names and labels.

    The latter is "" if some labels are on a server.
    """
    names = sorted(name for dataset in datasets for name in dataset.sample_ids)
    labels = sorted(
        f"{name} {digest}"
        for dataset in datasets
        for name, digest in digest_labels(dataset).items()
    )
    return {
        "num_validation_frames": len(names),
        "validation_frames": _digest(names),
        "validation_labels": _digest(labels) if len(labels) == len(names) else "",
    }


def training_change(before: Mapping[str, Any], now: Mapping[str, Any]) -> str | None:
    """Describe how a resumed run's training frames differ from its checkpoint's; None: not."""
    change = None if _is_reordered(before, now) else _other_frames("training", before, now)
    return change and f"{change}: check the lists, or begin a new run"


def validation_change(before: Mapping[str, Any], now: Mapping[str, Any]) -> str | None:
    """Describe how a resumed run's validation frames differ from its checkpoint's; None: not.

    Nothing is known of checkpoints that were written before the first validation, or by versions
    that recorded no validation frames.
    """
    if "validation_frames" not in before:
        return None
    change = _other_frames("validation", before, now)
    labels = [state["validation_labels"] for state in (before, now)]
    if change is None and all(labels) and labels[0] != labels[1]:
        change = "warning: the labels of the run's validation frames changed since its checkpoint"
    return change and (
        f"{change}: scores of before do not compare, so best.ckpt may stay though later weights "
        "are better; restore them, or begin a new run with --model.init_args.initial_weights "
        "RUN_FOLDER/last.ckpt"
    )


def _is_reordered(before: Mapping[str, Any], now: Mapping[str, Any]) -> bool:
    return bool(before.get(_ANY_ORDER) == now[_ANY_ORDER])


def _other_frames(use: str, before: Mapping[str, Any], now: Mapping[str, Any]) -> str | None:
    if before[f"{use}_frames"] == now[f"{use}_frames"]:
        return None
    had, has = before[f"num_{use}_frames"], now[f"num_{use}_frames"]
    numbers = f"{has} others" if had == has else f"{has}"
    return (
        f"warning: the run had {had} {use} frames when its checkpoint was written, and now has "
        f"{numbers}"
    )


def _digest(lines: Sequence[str]) -> str:
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()


def frames_of_checkpoint(
    state: Mapping[str, Any],
    sources: Sequence[SourceConfig],
    root: Path,
    parts: Collection[Part],
    is_held_out: Callable[[Path], bool],
) -> tuple[FramesByTree, bool]:
    """List the frames of training sources, as the run of a checkpoint may have opened them.

    The present command may validate or test on a folder on which the run did not, or the reverse.
    So frames are held out from each folder or not, whichever gives the names of the checkpoint.

    Args:
        state: Number and digests of the checkpoint's training frames.
        sources: Training sources; those that cannot be opened are left out.
        root: Base folder of their relative paths.
        parts: Parts of the samples.
        is_held_out: Function that tells if the present command holds out frames of a folder.

    Returns:
        The frames by folder, and whether they can be the checkpoint's.
    """

    @cache
    def names(position: int, *, held_out: bool) -> Collection[str] | None:
        uses = ["validation"] if held_out else []
        try:
            opened = open_source(
                sources[position], root, parts, held_out_for=uses, notify=lambda _: None
            )
        except (ValueError, OSError):  # scoring does not need them
            return None
        return opened.sample_ids

    trees = [data_tree(source, root) for source in sources]
    first: tuple[FramesByTree, bool] | None = None
    reordered: FramesByTree | None = None
    with warnings.catch_warnings(action="ignore"):  # these data are only listed
        for held_out in _divisions(sources, trees, is_held_out):
            frames: FramesByTree = {}
            listed = [names(i, held_out=held_out[tree]) for i, tree in enumerate(trees)]
            for tree, each in zip(trees, listed, strict=True):
                if each is not None:
                    frames.setdefault(tree, set()).update(each)
            found = frames_state(frames)
            if found["training_frames"] == state["training_frames"]:
                return frames, True
            if reordered is None and _is_reordered(state, found):
                reordered = frames
            is_part = found["num_training_frames"] < state["num_training_frames"]
            first = first or (frames, None in listed and is_part)
    assert first is not None, "there is one division at least"
    return first if reordered is None else (reordered, True)


def _divisions(
    sources: Sequence[SourceConfig], trees: Sequence[Path], is_held_out: Callable[[Path], bool]
) -> Iterator[dict[Path, bool]]:
    """Yield for each folder if frames are held out: as the command does, then otherwise."""
    own = {tree: is_held_out(tree) for tree in trees}
    yield own
    divided = {
        tree: None
        for source, tree in zip(sources, trees, strict=True)
        if source.sample_list in _DIVIDED_LISTS
    }
    number = len(divided)
    choices = product((False, True), repeat=number)
    uniform = ((value,) * number for value in (False, True))
    for choice in choices if number <= _MAX_TRIED_TREES else uniform:
        yield own | dict(zip(divided, choice, strict=True))

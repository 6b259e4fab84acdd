"""Doubts about the boxes of results: sizes, corners and places in another convention."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from sightline.data.kitti_labels import KittiObjects
from sightline.data.result_checks import (
    FEWEST_RESULTS,
    ScoredBoxes,
    joined,
    remarks_on_boxes2d,
    remarks_on_depths,
    remarks_on_repeats,
    remarks_on_scores,
    scored_boxes,
)
from sightline.evaluation.kitti_object_rules import CLASSES

_CLEARLY = 0.5  # by how much the logarithms of three sizes fit better in another order
_NAMES: Final = ("height", "width", "length")


@dataclass(slots=True)
class BoxConventions:
    """Boxes of results and labels over all frames, and what they have in common."""

    found: list[ScoredBoxes] = field(default_factory=list)
    labelled: list[ScoredBoxes] = field(default_factory=list)
    counts_repeats: bool = True
    """Whether a remark counts the results that occur twice in a frame."""

    def add(self, results: KittiObjects, labels: KittiObjects) -> None:
        """Keep the boxes of a frame."""
        self.found.append(scored_boxes(results))
        self.labelled.append(scored_boxes(labels))

    def remarks(self) -> Iterator[str]:
        """Sentences on what is probably of another convention."""
        if not self.found:
            return
        found, labelled = joined(self.found), joined(self.labelled)
        total = len(found.names)
        if self.counts_repeats:
            repeated = sum(each.num_repeated() for each in self.found)
            yield from _as_warnings(remarks_on_repeats(repeated, total))
        inverted = int((found.boxes2d[:, 2:] < found.boxes2d[:, :2]).any(axis=1).sum())
        if inverted:
            yield (
                f"WARNING: {inverted:,} of {total:,} results of scored classes have 2D boxes that "
                "end before they begin and overlap nothing: KITTI's are x_min, y_min, x_max, "
                "y_max, not x, y, width, height."
            )
        if len(labelled.names):
            yield from _as_warnings(remarks_on_boxes2d(found))
        yield from _as_warnings(remarks_on_scores(self.found))
        yield from _remarks_on_sizes(found, labelled)
        yield from _remarks_on_places(found, labelled)


def _as_warnings(remarks: Iterator[str]) -> Iterator[str]:
    return (f"WARNING: {remark}" for remark in remarks)


def _median(values: np.ndarray) -> np.ndarray | None:
    """Median row of those that are finite; None where they are too few."""
    finite = values[np.isfinite(values).all(axis=1)]
    return np.median(finite, axis=0) if len(finite) >= FEWEST_RESULTS else None


def _remarks_on_sizes(found: ScoredBoxes, labelled: ScoredBoxes) -> Iterator[str]:
    """A sentence for each class whose sizes are the labels' in another order."""
    for name in CLASSES:
        ours = _median(found.sizes_hwl[found.names == name])
        theirs = _median(labelled.sizes_hwl[labelled.names == name])
        if ours is None or theirs is None:
            continue
        misfits = {
            order: float(np.abs(np.log(ours / theirs[list(order)])).sum())
            for order in itertools.permutations(range(3))
        }
        best = min(misfits, key=lambda order: misfits[order])
        if misfits[0, 1, 2] - misfits[best] > _CLEARLY:
            written = ", ".join(_NAMES[column] for column in best)
            yield (
                f"WARNING: sizes of {name} in the results are probably in the order {written}: "
                "they were taken for height, width, length, as KITTI's files have them."
            )


def _remarks_on_places(found: ScoredBoxes, labelled: ScoredBoxes) -> Iterator[str]:
    ours, theirs = _median(found.locations), _median(labelled.locations)
    sizes_hwl = _median(labelled.sizes_hwl)
    if ours is None or theirs is None or sizes_hwl is None:
        return
    behind = tuple(_as_warnings(remarks_on_depths(found)))
    yield from behind
    if not behind and abs((ours[1] - theirs[1]) / sizes_hwl[0] + 0.5) < 0.15:
        yield (
            f"WARNING: 3D boxes of results lie {theirs[1] - ours[1]:.2f} m above those of labels, "
            "half their height: their y is probably that of the centre, KITTI's is that of the "
            "bottom."
        )

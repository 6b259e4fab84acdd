"""Doubts about the boxes of results: sizes, corners and places in another convention."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from sightline.data.box_readings import FEWEST_RESULTS
from sightline.data.kitti_labels import KittiObjects
from sightline.data.result_angles import remarks_on_alphas
from sightline.data.result_checks import (
    remarks_on_boxes2d,
    remarks_on_depths,
    remarks_on_repeats,
    remarks_on_scores,
)
from sightline.data.scored_boxes import ScoredBoxes, joined, scored_boxes
from sightline.evaluation.kitti_object_rules import CLASSES
from sightline.evaluation.other_readings import ComparedResults

_HALF_WITHIN = 0.15  # by how much of its height the middle of a box may miss its centre
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
        yield from _as_warnings(self._remarks_on_boxes(found, labelled))

    def _remarks_on_boxes(self, found: ScoredBoxes, labelled: ScoredBoxes) -> Iterator[str]:
        """Sentences on boxes, angles and scores, by the labels where there are any."""
        compared = ComparedResults.of(self.found, self.labelled)
        in_image = (*(remarks_on_boxes2d(found) if len(labelled.names) else ()),)
        in_image = in_image or (*compared.remarks_on_boxes2d(),) or (*_remarks_on_corners(found),)
        in_space = (*_remarks_on_sizes(found, labelled), *_remarks_on_places(found, compared))
        yield from in_image
        scores = (*remarks_on_scores(self.found),)
        yield from scores or compared.remarks_on_order()
        yield from in_space
        turned = () if in_space else (*compared.remarks_on_rotations(),)
        yield from turned or (() if in_space else remarks_on_alphas(found))
        if not in_image and not in_space and compared.frames:
            yield from compared.remarks_on_parts()


def _remarks_on_corners(found: ScoredBoxes) -> Iterator[str]:
    inverted = int((found.boxes2d[:, 2:] < found.boxes2d[:, :2]).any(axis=1).sum())
    if inverted:
        yield (
            f"{inverted:,} of {len(found.names):,} results of scored classes have 2D boxes that "
            "end before they begin and overlap nothing: KITTI's are x_min, y_min, x_max, y_max, "
            "not x, y, width, height."
        )


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
                f"sizes of {name} in the results are probably in the order {written}: "
                "they were taken for height, width, length, as KITTI's files have them."
            )


def _remarks_on_places(found: ScoredBoxes, compared: ComparedResults) -> Iterator[str]:
    behind = tuple(remarks_on_depths(found))
    yield from behind
    rise = None if behind else compared.median_rise()
    if rise is not None and abs(rise - 0.5) < _HALF_WITHIN:
        yield (
            f"3D boxes of results lie {rise:.2f} of their height above those of labels: their y is "
            "probably that of the centre, KITTI's is that of the bottom."
        )

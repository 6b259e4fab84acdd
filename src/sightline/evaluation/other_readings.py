"""Conventions in which results meet clearly more labels than as they are written."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float64

from sightline.data.box_readings import (
    FEWEST_RESULTS,
    MET_IOU,
    READINGS,
    fits_better,
    image_ious,
    is_clear,
)
from sightline.data.result_angles import angle_between
from sightline.data.scored_boxes import ScoredBoxes
from sightline.evaluation.auroc import auroc_of_values
from sightline.evaluation.kitti_object_overlaps import ground_and_space_overlap

_MOST_FRAMES: Final = 500
"""Number of frames to compare, spread evenly."""
_BESIDE_M: Final = 1.0
"""Largest distance from above of a result that stands where a label does."""
_FACING_RAD: Final = 0.35
"""Largest difference of the directions of two boxes that face the same way."""
_MET_SPACE_IOU: Final = 0.25
"""IoU from which a 3D box meets another one."""
_FEWEST_MET: Final = 10
"""Fewest labels from which a doubt is raised that chance could raise for `FEWEST_RESULTS`."""
_FEWEST_MOVED: Final = 20
"""Fewest labels that tell that results are those of a neighbouring frame."""
_SELDOM: Final = 0.05
"""Share of the labels met in one way that are met in the other way by chance: in rows of parked
cars a box 10 m too far meets another car in up to 9 % of them, which raises no doubt."""
_LOW_AUROC: Final = 0.4
"""AUROC of scores that are reversed; the shipped detectors have 0.81 or more on 90 real frames."""
_SURELY: Final = 4.0
"""Number of standard deviations by which the AUROC is below one half where scores are reversed."""


@dataclass(frozen=True, slots=True)
class ComparedResults:
    """Results beside the labels of some frames."""

    frames: tuple[tuple[ScoredBoxes, ScoredBoxes], ...]
    """Results and labels, of frames with labels."""
    before: tuple[ScoredBoxes | None, ...]
    """Results of the frame before each; None for the first."""
    after: tuple[ScoredBoxes | None, ...]

    @classmethod
    def of(cls, found: Sequence[ScoredBoxes], labelled: Sequence[ScoredBoxes]) -> "ComparedResults":
        """Choose the frames from all, in their order."""
        places = [place for place, each in enumerate(labelled) if len(each.names)]
        places = places[:: -(-len(places) // _MOST_FRAMES) or 1]
        return cls(
            frames=tuple((found[place], labelled[place]) for place in places),
            before=tuple(found[place - 1] if place else None for place in places),
            after=tuple(found[place + 1] if place + 1 < len(found) else None for place in places),
        )

    def remarks_on_boxes2d(self) -> Iterator[str]:
        """Yield a sentence on 2D boxes, or whole frames, of another convention."""
        written = self._best_ious()
        others = {f"2D boxes of results are probably {name}": name for name in READINGS}
        others["results are probably those of the next frame"] = "before"
        others["results are probably those of the frame before"] = "after"
        for cause, name in others.items():
            ious = self._best_ious(name)
            better, worse = fits_better(ious, written).sum(), fits_better(written, ious).sum()
            # between neighbouring frames of a drive only few boxes move
            total = len(ious) if name in READINGS else better + worse
            fewest = 0 if name in READINGS else _FEWEST_MOVED
            if better >= fewest and is_clear(int(better), int(worse), int(total)):
                yield (
                    f"{cause}: taken so they meet {better:,} of {len(ious):,} labelled objects "
                    f"clearly better in the image, and {worse:,} worse."
                )
                return

    def median_rise(self) -> float | None:
        """Compute how far results lie above their labels, in heights; None with too few."""
        rises = [
            (labels.locations[label, 1] - found.locations[result, 1]) / labels.sizes_hwl[label, 0]
            for found, labels in self.frames
            for label, result in _neighbours(found, labels)
        ]
        return float(np.median(rises)) if len(rises) >= FEWEST_RESULTS else None

    def remarks_on_rotations(self) -> Iterator[str]:
        """Yield a sentence on 3D boxes at labels that face another way."""
        pairs = [
            (found.rotations_y[result], labels.rotations_y[label])
            for found, labels in self.frames
            for label, result in _neighbours(found, labels)
        ]
        ours, theirs = np.array(pairs).reshape(-1, 2).T
        ending = "KITTI's is 0 towards x and positive from z to x, clockwise from above."
        written = angle_between(ours, theirs, period=np.pi)
        for name, other in (("negated", -ours), ("the LiDAR frame's yaw", -np.pi / 2 - ours)):
            turned = angle_between(other, theirs, period=np.pi)
            better = int(((turned < _FACING_RAD) & (written > 2 * _FACING_RAD)).sum())
            worse = int(((written < _FACING_RAD) & (turned > 2 * _FACING_RAD)).sum())
            if better >= _FEWEST_MET and is_clear(better, worse, better + worse):
                yield (
                    f"rotation_y of results is probably {name}: of {len(ours):,} results at a "
                    f"labelled object {int((turned < _FACING_RAD).sum()):,} lie along it if taken "
                    f"so, as they are {int((written < _FACING_RAD).sum()):,}; {ending}"
                )
                return
        reversed_ = int((angle_between(ours, theirs) > np.pi - _FACING_RAD).sum())
        if reversed_ >= _FEWEST_MET and reversed_ > 0.8 * len(ours):
            yield (
                f"{reversed_:,} of {len(ours):,} results at a labelled object face the opposite "
                f"way: rotation_y is half a turn off, or negated; {ending}"
            )

    def remarks_on_order(self) -> Iterator[str]:
        """Yield a sentence on scores that rank false results above true ones."""
        hits = [self._hits(*frame) for frame in self.frames]
        scores = np.concatenate([found.scores for found, _ in self.frames]) if hits else np.empty(0)
        is_hit = np.concatenate(hits) if hits else np.empty(0, dtype=bool)
        num_true, num_false = int(is_hit.sum()), int((~is_hit).sum())
        if min(num_true, num_false) < _FEWEST_MET:
            return
        area = auroc_of_values(scores[is_hit], scores[~is_hit])
        assert area is not None, "both groups have results"
        deviation = np.sqrt((num_true + num_false + 1) / (12 * num_true * num_false))
        if area < min(_LOW_AUROC, 0.5 - _SURELY * deviation):
            yield (
                f"scores of results are probably reversed: a result at a labelled object has a "
                f"higher score than one beside all in only {100 * area:.0f} % of the pairs of "
                f"{num_true:,} and {num_false:,}; the highest score ranks first."
            )

    def remarks_on_parts(self) -> Iterator[str]:
        """Yield a sentence on results that meet labels in the image or in 3D only."""
        in_image = self._best_ious()
        has_3d = [
            labels.has_3d[:, None] & found.has_3d & _same_class(found, labels)
            for found, labels in self.frames
        ]
        in_space = np.concatenate(
            [
                _space_ious(found, labels, possible).max(axis=1, initial=0)
                for (found, labels), possible in zip(self.frames, has_3d, strict=True)
            ]
        )
        both = np.concatenate([each.any(axis=1) for each in has_3d])
        met, met_3d = _num_met(in_image[both]), int((in_space[both] > _MET_SPACE_IOU).sum())
        counts = (
            f"of {int(both.sum()):,} labelled objects {met:,} are met in the image (IoU "
            f"{MET_IOU:g}) and {met_3d:,} in 3D (IoU above {_MET_SPACE_IOU:g})"
        )
        if met >= _FEWEST_MET and met_3d < _SELDOM * met:
            yield (
                f"2D boxes of results meet labels and 3D boxes do not: {counts}; look at "
                "location, sizes and rotation_y, and whether both are of the same frame."
            )
        elif met_3d >= _FEWEST_MET and met < _SELDOM * met_3d:
            yield (
                f"3D boxes of results meet labels and 2D boxes do not: {counts}; look at x_min, "
                "y_min, x_max, y_max, and at the image's size."
            )

    def _best_ious(self, reading: str = "") -> Float64[np.ndarray, " num_labels"]:
        """Find each label's largest IoU in the image with a result of its class."""
        best = []
        frames = zip(self.frames, self.before, self.after, strict=True)
        for (own, labels), before, after in frames:
            found = {"before": before, "after": after}.get(reading, own)
            if found is None:
                best.append(np.zeros(len(labels.names)))
                continue
            boxes = READINGS[reading](found.boxes2d) if reading in READINGS else found.boxes2d
            ious = image_ious(labels.boxes2d[:, None], boxes[None])
            best.append((ious * _same_class(found, labels)).max(axis=1, initial=0))
        return np.concatenate(best) if best else np.empty(0)

    @staticmethod
    def _hits(found: ScoredBoxes, labels: ScoredBoxes) -> Bool[np.ndarray, " num_results"]:
        """Mask of the results at a labelled object of their class, in the image or in 3D."""
        ious = image_ious(labels.boxes2d[:, None], found.boxes2d[None])
        is_met = (ious >= MET_IOU) & _same_class(found, labels)
        return np.asarray((is_met | (_distances_m(found, labels) < _BESIDE_M)).any(axis=0))


def _num_met(ious: Float64[np.ndarray, " num"]) -> int:
    return int((ious >= MET_IOU).sum())


def _neighbours(found: ScoredBoxes, labels: ScoredBoxes) -> list[tuple[int, int]]:
    """List the labels that have a result beside them, with the nearest one."""
    if not len(found.names):
        return []
    distances_m = _distances_m(found, labels)
    beside = np.flatnonzero(distances_m.min(axis=1) < _BESIDE_M)
    return [(label, int(distances_m[label].argmin())) for label in beside.tolist()]


def _same_class(
    found: ScoredBoxes, labels: ScoredBoxes
) -> Bool[np.ndarray, "num_labels num_results"]:
    return np.asarray(labels.names[:, None] == found.names[None], dtype=bool)


def _distances_m(
    found: ScoredBoxes, labels: ScoredBoxes
) -> Float64[np.ndarray, "num_labels num_results"]:
    """Compute the distances from above of boxes of one class; infinite otherwise."""
    apart = labels.locations[:, None, ::2] - found.locations[None, :, ::2]
    distances_m = np.where(_same_class(found, labels), np.hypot(*np.moveaxis(apart, -1, 0)), np.inf)
    return np.where(np.isnan(distances_m), np.inf, distances_m)


def _space_ious(
    found: ScoredBoxes, labels: ScoredBoxes, possible: Bool[np.ndarray, "num_labels num_results"]
) -> Float64[np.ndarray, "num_labels num_results"]:
    """Compute the IoU of upright boxes where it is possible, 0 elsewhere."""
    ious = np.zeros(possible.shape)
    ours, theirs = _rows(found), _rows(labels)
    reach_m = np.nan_to_num(np.linalg.norm(found.sizes_hwl, axis=1))
    reach_m = reach_m + np.nan_to_num(np.linalg.norm(labels.sizes_hwl, axis=1))[:, None]
    near = possible & (_distances_m(found, labels) < reach_m)
    for label, result in np.argwhere(near).tolist():
        ious[label, result] = ground_and_space_overlap(ours[result], theirs[label])[1]
    return ious


def _rows(boxes: ScoredBoxes) -> Float64[np.ndarray, "num_boxes 11"]:
    """Arrange boxes as rows of `kitti_object_overlaps`."""
    columns = (boxes.boxes2d, boxes.sizes_hwl, boxes.locations, boxes.rotations_y[:, None])
    return np.concatenate(columns, axis=1)

"""Doubts about the boxes of results, compared with labels: boxes and scores in another convention.

`ResultConventions` collects the frames of an evaluation. Where results match clearly more labels
read in another way than as they are written, they are probably in that convention.
"""

import itertools
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from jaxtyping import Bool, Float64, Shaped

from sightline.data.alpha_checks import ALPHA_REMEDY, doubt_about_labels, remarks_on_alphas
from sightline.data.kitti_labels import NO_ALPHA, KittiObjects
from sightline.data.label_checks import order_of_sizes, scale_of_sizes
from sightline.data.result_boxes import (
    BOX2D_CONVENTIONS,
    MATCH_IOU,
    MIN_RESULTS,
    ScoredBoxes,
    angle_between,
    image_ious,
    is_clearly_better,
    join_boxes,
    matches_better,
    scored_boxes,
)
from sightline.data.result_checks import (
    count_impossible,
    remark_on_scale,
    remarks_on_boxes2d,
    remarks_on_depths,
    remarks_on_far_boxes2d,
    remarks_on_impossible,
    remarks_on_repeats,
    remarks_on_scores,
)
from sightline.evaluation.auroc import auroc_of_values
from sightline.evaluation.kitti_object_overlaps import ground_and_space_overlap
from sightline.evaluation.kitti_object_rules import CLASSES

_MAX_FRAMES: Final = 500
"""Maximum number of frames to compare, spread evenly."""
_HEIGHT_TOLERANCE: Final = 0.15
"""Largest deviation of the rise of box centres from half the height, in heights."""
_SIZE_MARGIN: Final = 0.5
"""Margin by which the logarithms of three sizes fit better in another order."""
_MAX_DISTANCE_M: Final = 1.0
"""Largest distance from above of a result at a labelled object."""
_MAX_ANGLE_RAD: Final = 0.35
"""Largest difference of the directions of two boxes that face the same way."""
_MATCH_IOU_3D: Final = 0.25
"""Minimum IoU of two 3D boxes of one object."""
_MIN_MATCHES: Final = 10
"""Minimum number of matched labels for a doubt that `MIN_RESULTS` could raise by chance."""
_MIN_MOVED: Final = 20
"""Minimum number of labels by which results of a neighbouring frame are recognised."""
_CHANCE_SHARE: Final = 0.05
"""Share of the labels matched in one way that are matched in the other way by chance: in rows of
parked cars a box 10 m too far matches another car in up to 9 % of them, which raises no doubt."""
_REVERSED_AUROC: Final = 0.4
"""AUROC of reversed scores; the shipped detectors have 0.81 or more on 90 real frames."""
_MIN_DEVIATIONS: Final = 4.0
"""Number of standard deviations by which the AUROC of reversed scores is below one half."""
_SIZE_NAMES: Final = ("height", "width", "length")
_ROTATION_CONVENTION: Final = (
    "KITTI's is 0 towards x and positive from z to x, clockwise from above."
)


@dataclass(slots=True)
class ResultConventions:
    """Boxes of results and labels over all frames, and doubts about their convention."""

    results: list[ScoredBoxes] = field(default_factory=list)
    labels: list[ScoredBoxes] = field(default_factory=list)
    impossible: list[Counter[str]] = field(default_factory=list)
    """Counts of impossible values of each frame's results."""
    in_degrees: bool = False
    """Whether angles of results are in degrees, which another remark says."""
    counts_repeats: bool = True
    """Whether a remark counts the results that occur twice in their frame."""

    total: int = 0
    """Number of results of all classes."""
    without_alpha: int = 0
    """Number of these without an alpha; with one of them no orientation is scored."""

    def add(self, results: KittiObjects, labels: KittiObjects) -> None:
        """Keep the boxes of a frame."""
        self.total += len(results)
        self.without_alpha += int(np.count_nonzero(results.alpha == NO_ALPHA))
        self.results.append(scored_boxes(results))
        self.impossible.append(count_impossible(results))
        self.labels.append(scored_boxes(labels))

    def remarks(self) -> Iterator[str]:
        """Yield sentences on boxes and scores that are probably of another convention."""
        if not self.results:
            return
        for remark in self._remarks(join_boxes(self.results), join_boxes(self.labels)):
            yield f"WARNING: {remark}"

    def _remarks(self, results: ScoredBoxes, labels: ScoredBoxes) -> Iterator[str]:
        if self.counts_repeats:
            repeated = sum(each.num_repeated() for each in self.results)
            yield from remarks_on_repeats(repeated, len(results.names))
        yield from remarks_on_impossible(self.impossible, len(results.names))
        compared = _ComparedResults.of(self.results, self.labels)
        in_image = (*(remarks_on_boxes2d(results) if len(labels.names) else ()),)
        in_image = in_image or (*compared.remarks_on_boxes2d(),) or (*_remarks_on_corners(results),)
        in_space = (*_remarks_on_sizes(results, labels), *_remarks_on_places(results, compared))
        yield from in_image or remarks_on_far_boxes2d(results)
        scores = (*remarks_on_scores(self.results),)
        yield from scores or compared.remarks_on_order()
        yield from in_space
        if 0 < self.without_alpha < self.total:
            yield (
                f"alpha of {self.without_alpha:,} of {self.total:,} results is {NO_ALPHA:g}, "
                "KITTI's number for none: orientation is scored only where all results have one, "
                f"those of other classes too; {ALPHA_REMEDY}, or leave these results out."
            )
        if not self.in_degrees:
            rotations = () if in_space else (*compared.remarks_on_rotations(),)
            doubt = doubt_about_labels(labels)
            if doubt is not None and (not self.without_alpha or rotations):
                yield f"{doubt}: scores of orientation compare it with results'; {ALPHA_REMEDY}."
                if np.ptp(labels.alphas):  # they tell that rotation_y of labels may be at fault
                    rotations = ()
            yield from rotations or (() if in_space else remarks_on_alphas(results))
        if not in_image and not in_space and compared.frames:
            yield from compared.remarks_on_parts()


def _remarks_on_corners(results: ScoredBoxes) -> Iterator[str]:
    inverted = int((results.boxes2d[:, 2:] < results.boxes2d[:, :2]).any(axis=1).sum())
    if inverted:
        yield (
            f"{inverted:,} of {len(results.names):,} results of scored classes have 2D boxes that "
            "end before they begin and overlap nothing: KITTI's are x_min, y_min, x_max, y_max, "
            "not x, y, width, height."
        )


def _remarks_on_sizes(results: ScoredBoxes, labels: ScoredBoxes) -> Iterator[str]:
    """Yield a sentence for each class whose sizes are the labels' in another order."""
    for name in CLASSES:
        written = _median(results.sizes_hwl[results.names == name])
        expected = _median(labels.sizes_hwl[labels.names == name])
        if written is None or expected is None:
            continue
        misfits = {
            order: float(np.abs(np.log(written / expected[list(order)])).sum())
            for order in itertools.permutations(range(3))
        }
        best = min(misfits, key=lambda order: misfits[order])
        if misfits[0, 1, 2] - misfits[best] > _SIZE_MARGIN:
            order, kind = ", ".join(_SIZE_NAMES[column] for column in best), "results"
            is_class = labels.names == name
            if (wrong := order_of_sizes(labels.sizes_hwl[is_class], labels.names[is_class])) and (
                order_of_sizes(written[None], np.array([name])) is None
            ):
                order, kind = wrong, "labels"
            yield (
                f"sizes of {name} in the {kind} are probably in the order {order}: "
                "they were taken for height, width, length, as KITTI's files have them."
            )
        elif (scale := scale_of_sizes(written, name, expected)) is not None:
            yield remark_on_scale([name], scale)


def _median(values: Float64[np.ndarray, "num 3"]) -> Float64[np.ndarray, "3"] | None:
    """Compute the median of the finite rows; None if they are too few."""
    finite = values[np.isfinite(values).all(axis=1)]
    return np.median(finite, axis=0) if len(finite) >= MIN_RESULTS else None


def _remarks_on_places(results: ScoredBoxes, compared: "_ComparedResults") -> Iterator[str]:
    behind = tuple(remarks_on_depths(results))
    yield from behind
    if behind:
        return
    names, rises = compared.rises()
    groups = {"": rises} | {f" of {name}": rises[names == name] for name in CLASSES}
    for of_class, group in groups.items():
        rise = float(np.median(group)) if len(group) >= MIN_RESULTS else 0.0
        if abs(abs(rise) - 0.5) < _HEIGHT_TOLERANCE:
            higher, lower = ("results", "labels") if rise > 0 else ("labels", "results")
            yield (
                f"3D boxes{of_class} of {higher} lie {abs(rise):.2f} of their height above those "
                f"of {lower}: their y is probably that of the centre, KITTI's is that of the "
                "bottom."
            )
            return


@dataclass(frozen=True, slots=True)
class _ComparedResults:
    """Results beside the labels of some frames."""

    frames: tuple[tuple[ScoredBoxes, ScoredBoxes], ...]
    """Results and labels, of frames with labels."""
    before: tuple[ScoredBoxes | None, ...]
    """Results of the frame before each; None for the first."""
    after: tuple[ScoredBoxes | None, ...]

    @classmethod
    def of(
        cls, results: Sequence[ScoredBoxes], labels: Sequence[ScoredBoxes]
    ) -> "_ComparedResults":
        """Choose the frames from all, in their order."""
        indices = [index for index, each in enumerate(labels) if len(each.names)]
        indices = indices[:: -(-len(indices) // _MAX_FRAMES) or 1]
        return cls(
            frames=tuple((results[index], labels[index]) for index in indices),
            before=tuple(results[index - 1] if index else None for index in indices),
            after=tuple(
                results[index + 1] if index + 1 < len(results) else None for index in indices
            ),
        )

    def remarks_on_boxes2d(self) -> Iterator[str]:
        """Yield a sentence on 2D boxes, or whole frames, of another convention."""
        written = self._best_ious()
        others = {f"2D boxes of results are probably {name}": name for name in BOX2D_CONVENTIONS}
        others["results are probably those of the next frame"] = "before"
        others["results are probably those of the frame before"] = "after"
        for cause, name in others.items():
            ious = self._best_ious(name)
            better = int(matches_better(ious, written).sum())
            worse = int(matches_better(written, ious).sum())
            # between neighbouring frames of a drive only few boxes move
            total = len(ious) if name in BOX2D_CONVENTIONS else better + worse
            min_better = 0 if name in BOX2D_CONVENTIONS else _MIN_MOVED
            if better >= min_better and is_clearly_better(better, worse, total):
                yield (
                    f"{cause}: read so they match {better:,} of {len(ious):,} labelled objects "
                    f"clearly better in the image, and {worse:,} worse; or labels are at fault."
                )
                return

    def rises(self) -> tuple[Shaped[np.ndarray, " pairs"], Float64[np.ndarray, " pairs"]]:
        """Compute how far results lie above their labels, in heights, beside their classes."""
        pairs = [
            (
                labels.names[label],
                (labels.locations[label, 1] - results.locations[result, 1])
                / labels.sizes_hwl[label, 0],
            )
            for results, labels in self.frames
            for label, result in _nearest_results(results, labels)
        ]
        return np.array([name for name, _ in pairs]), np.array([rise for _, rise in pairs], float)

    def remarks_on_rotations(self) -> Iterator[str]:
        """Yield a sentence on 3D boxes at labels that face another way."""
        pairs = [
            (results.rotations_y[result], labels.rotations_y[label])
            for results, labels in self.frames
            for label, result in _nearest_results(results, labels)
        ]
        angles, expected = np.array(pairs).reshape(-1, 2).T
        written = angle_between(angles, expected, period=np.pi)
        for name, other in (("negated", -angles), ("the LiDAR frame's yaw", -np.pi / 2 - angles)):
            turned = angle_between(other, expected, period=np.pi)
            better = int(((turned < _MAX_ANGLE_RAD) & (written > 2 * _MAX_ANGLE_RAD)).sum())
            worse = int(((written < _MAX_ANGLE_RAD) & (turned > 2 * _MAX_ANGLE_RAD)).sum())
            if better >= _MIN_MATCHES and is_clearly_better(better, worse, better + worse):
                yield (
                    f"rotation_y of results is probably {name}: of {len(angles):,} results at a "
                    f"labelled object {int((turned < _MAX_ANGLE_RAD).sum()):,} lie along it if "
                    f"read so, {int((written < _MAX_ANGLE_RAD).sum()):,} as they are written; "
                    f"{_ROTATION_CONVENTION}"
                )
                return
        reversed_ = int((angle_between(angles, expected) > np.pi - _MAX_ANGLE_RAD).sum())
        if reversed_ >= _MIN_MATCHES and reversed_ > 0.8 * len(angles):
            yield (
                f"{reversed_:,} of {len(angles):,} results at a labelled object face the opposite "
                f"way: rotation_y is half a turn off, or negated; {_ROTATION_CONVENTION}"
            )

    def remarks_on_order(self) -> Iterator[str]:
        """Yield a sentence on scores that rank false results above true ones."""
        if not self.frames:
            return
        scores = np.concatenate([results.scores for results, _ in self.frames])
        is_hit = np.concatenate([_at_labels(*frame) for frame in self.frames])
        num_true, num_false = int(is_hit.sum()), int((~is_hit).sum())
        if min(num_true, num_false) < _MIN_MATCHES:
            return
        area = auroc_of_values(scores[is_hit], scores[~is_hit])
        assert area is not None, "both groups have results"
        deviation = np.sqrt((num_true + num_false + 1) / (12 * num_true * num_false))
        if area < min(_REVERSED_AUROC, 0.5 - _MIN_DEVIATIONS * deviation):
            yield (
                "scores of results are probably reversed: a result at a labelled object has a "
                f"higher score than one at none in only {100 * area:.0f} % of the pairs of "
                f"{num_true:,} and {num_false:,}; the highest score ranks first."
            )

    def remarks_on_parts(self) -> Iterator[str]:
        """Yield a sentence on results that match labels in the image or in 3D only."""
        in_image = self._best_ious()
        has_3d = [
            labels.has_3d[:, None] & results.has_3d & _same_class(results, labels)
            for results, labels in self.frames
        ]
        in_space = np.concatenate(
            [
                _space_ious(results, labels, possible).max(axis=1, initial=0)
                for (results, labels), possible in zip(self.frames, has_3d, strict=True)
            ]
        )
        both = np.concatenate([each.any(axis=1) for each in has_3d])
        num_2d = int((in_image[both] >= MATCH_IOU).sum())
        num_3d = int((in_space[both] > _MATCH_IOU_3D).sum())
        counts = (
            f"of {int(both.sum()):,} labelled objects {num_2d:,} are matched in the image (IoU "
            f"{MATCH_IOU:g}) and {num_3d:,} in 3D (IoU above {_MATCH_IOU_3D:g})"
        )
        if num_2d >= _MIN_MATCHES and num_3d < _CHANCE_SHARE * num_2d:
            yield (
                f"2D boxes of results match labels and 3D boxes do not: {counts}; look at "
                "location, sizes and rotation_y, and whether both are of the same frame."
            )
        elif num_3d >= _MIN_MATCHES and num_2d < _CHANCE_SHARE * num_3d:
            yield (
                f"3D boxes of results match labels and 2D boxes do not: {counts}; look at x_min, "
                "y_min, x_max, y_max, and at the image's size."
            )

    def _best_ious(self, convention: str = "") -> Float64[np.ndarray, " num_labels"]:
        """Compute each label's largest IoU in the image with a result of its class.

        Args:
            convention: Name in `BOX2D_CONVENTIONS`; or `before` or `after`, for the results of a
                neighbouring frame; empty: results as they are written.
        """
        convert = BOX2D_CONVENTIONS.get(convention)
        best = []
        frames = zip(self.frames, self.before, self.after, strict=True)
        for (own, labels), before, after in frames:
            results = {"before": before, "after": after}.get(convention, own)
            if results is None:
                best.append(np.zeros(len(labels.names)))
                continue
            boxes = results.boxes2d if convert is None else convert(results.boxes2d)
            ious = image_ious(labels.boxes2d[:, None], boxes[None])
            best.append((ious * _same_class(results, labels)).max(axis=1, initial=0))
        return np.concatenate(best) if best else np.empty(0)


def _at_labels(results: ScoredBoxes, labels: ScoredBoxes) -> Bool[np.ndarray, " num_results"]:
    """Mask of the results at a labelled object of their class, in the image or in 3D."""
    ious = image_ious(labels.boxes2d[:, None], results.boxes2d[None])
    is_match = (ious >= MATCH_IOU) & _same_class(results, labels)
    return np.asarray((is_match | (_distances_m(results, labels) < _MAX_DISTANCE_M)).any(axis=0))


def _nearest_results(results: ScoredBoxes, labels: ScoredBoxes) -> list[tuple[int, int]]:
    """List the labels with a result nearby, each with the nearest one."""
    if not len(results.names):
        return []
    distances_m = _distances_m(results, labels)
    near = np.flatnonzero(distances_m.min(axis=1) < _MAX_DISTANCE_M)
    return [(label, int(distances_m[label].argmin())) for label in near.tolist()]


def _same_class(
    results: ScoredBoxes, labels: ScoredBoxes
) -> Bool[np.ndarray, "num_labels num_results"]:
    return np.asarray(labels.names[:, None] == results.names[None], dtype=bool)


def _distances_m(
    results: ScoredBoxes, labels: ScoredBoxes
) -> Float64[np.ndarray, "num_labels num_results"]:
    """Compute the distances from above of boxes of one class; infinite otherwise."""
    offsets = labels.locations[:, None, ::2] - results.locations[None, :, ::2]
    is_same = _same_class(results, labels)
    distances_m = np.where(is_same, np.hypot(*np.moveaxis(offsets, -1, 0)), np.inf)
    return np.where(np.isnan(distances_m), np.inf, distances_m)


def _space_ious(
    results: ScoredBoxes, labels: ScoredBoxes, possible: Bool[np.ndarray, "num_labels num_results"]
) -> Float64[np.ndarray, "num_labels num_results"]:
    """Compute the IoU of upright boxes where it is possible, 0 elsewhere."""
    ious = np.zeros(possible.shape)
    result_rows, label_rows = _rows(results), _rows(labels)
    reach_m = np.nan_to_num(np.linalg.norm(results.sizes_hwl, axis=1))
    reach_m = reach_m + np.nan_to_num(np.linalg.norm(labels.sizes_hwl, axis=1))[:, None]
    near = possible & (_distances_m(results, labels) < reach_m)
    for label, result in np.argwhere(near).tolist():
        ious[label, result] = ground_and_space_overlap(result_rows[result], label_rows[label])[1]
    return ious


def _rows(boxes: ScoredBoxes) -> Float64[np.ndarray, "num_boxes 11"]:
    """Arrange boxes as rows of `kitti_object_overlaps`."""
    columns = (boxes.boxes2d, boxes.sizes_hwl, boxes.locations, boxes.rotations_y[:, None])
    return np.concatenate(columns, axis=1)

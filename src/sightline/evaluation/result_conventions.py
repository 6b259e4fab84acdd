"""Doubts about the boxes of results, compared with labels: boxes and scores in another convention.

`ResultConventions` collects the frames of an evaluation. Where results match clearly more labels
read in another way than as they are written, they are probably in that convention.
"""

import itertools
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from sightline.data.checks.alpha_checks import ALPHA_REMEDY, doubt_about_labels, remarks_on_alphas
from sightline.data.checks.image_fits import OTHER_IMAGE, ImageFit, fit_image
from sightline.data.checks.label_checks import gives_box3d, order_of_sizes, scale_of_sizes
from sightline.data.checks.result_boxes import (
    BOX2D_CONVENTIONS,
    MATCH_IOU,
    MIN_RESULTS,
    Boxes,
    ScoredBoxes,
    best_reading,
    image_ious,
    is_clearly_better,
    join_boxes,
    matches_better,
    scored_boxes,
)
from sightline.data.checks.result_checks import (
    count_impossible,
    remark_on_scale,
    remarks_on_boxes2d,
    remarks_on_corners,
    remarks_on_depths,
    remarks_on_far_boxes2d,
    remarks_on_impossible,
    remarks_on_repeats,
    remarks_on_scores,
)
from sightline.data.formats.kitti_labels import NO_ALPHA, KittiObjects
from sightline.evaluation.auroc import auroc_of_values
from sightline.evaluation.box_pairs import (
    MAX_DISTANCE_M,
    ground_distances_m,
    same_class,
    space_ious,
)
from sightline.evaluation.kitti_object_rules import CLASSES
from sightline.evaluation.place_doubts import (
    MIN_MATCHES,
    remarks_on_centres,
    remarks_on_offsets,
    remarks_on_rotations,
    rise_evenly,
)

_MAX_FRAMES: Final = 500
"""Maximum number of frames to compare, spread evenly."""
_SIZE_MARGIN: Final = 0.5
"""Margin by which the logarithms of three sizes fit better in another order."""
_MATCH_IOU_3D: Final = 0.25
"""Minimum IoU of two 3D boxes of one object."""
_MIN_MOVED: Final = 20
"""Minimum number of labels by which results of a neighbouring frame are recognised."""
_CHANCE_SHARE: Final = 0.05
"""Share of the labels matched in one way that are matched in the other way by chance: in rows of
parked cars a box 10 m too far matches another car in up to 9 % of them, which raises no doubt."""
_REVERSED_AUROC: Final = 0.4
"""AUROC of reversed scores; the shipped detectors have 0.81 or more on 90 real frames."""
_MIN_PAIRED: Final = 10
"""Number of a frame's results with the highest scores that are paired, or twice its labels."""
_MIN_DEVIATIONS: Final = 4.0
"""Number of standard deviations by which the AUROC of reversed scores is below one half."""
_SIZE_NAMES: Final = ("height", "width", "length")
_LEAST_PERCENT: Final = 20.0
"""Highest score from which scores are percent and no logarithms of odds."""


class Remark(NamedTuple):
    """Sentence on boxes or scores of results."""

    text: str
    convention: str = ""
    """Convention of the writer, which no faulty sensor causes; empty: a sensor may have."""


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
    lacking_alpha: int = 0
    """Number of those with a 3D part, by which alpha could be known."""

    def add(self, results: KittiObjects, labels: KittiObjects) -> None:
        """Keep the boxes of a frame."""
        self.total += len(results)
        is_without = results.alpha == NO_ALPHA
        self.without_alpha += int(np.count_nonzero(is_without))
        self.lacking_alpha += int(np.count_nonzero(is_without & gives_box3d(results)))
        self.results.append(scored_boxes(results))
        self.impossible.append(count_impossible(results))
        self.labels.append(scored_boxes(labels))

    def remarks(self) -> Iterator[Remark]:
        """Yield sentences on boxes and scores that are probably of another convention."""
        if not self.results:
            return
        if self.without_alpha < self.total and self.without_alpha > self.lacking_alpha == 0:
            yield Remark(
                f"Orientation is not scored: {self.without_alpha:,} of {self.total:,} results have "
                "no 3D part and so no alpha. It is of results that all have one (perceive writes "
                "both joined and joined-3d)."
            )
        for remark in self._remarks(join_boxes(self.results), join_boxes(self.labels)):
            yield remark._replace(text=f"WARNING: {remark.text}")

    def _remarks(self, results: ScoredBoxes, labels: ScoredBoxes) -> Iterator[Remark]:
        if self.counts_repeats:
            repeated = sum(each.num_repeated() for each in self.results)
            yield from map(Remark, remarks_on_repeats(repeated, len(results.names)))
        yield from map(Remark, remarks_on_impossible(self.impossible, len(results.names)))
        compared = _ComparedResults.of(self.results, self.labels)
        in_image = _of(remarks_on_boxes2d(results) if len(labels.names) else ())
        in_image = in_image or (*compared.remarks_on_boxes2d(),) or _of(remarks_on_corners(results))
        in_space = self._remarks_in_space(results, labels, compared)
        yield from in_image or map(Remark, remarks_on_far_boxes2d(results))
        scores = _of(remarks_on_scores(self.results), _convention_of_scores(results))
        yield from scores or map(Remark, compared.remarks_on_order())
        yield from in_space
        yield from map(Remark, self._remarks_on_angles(results, labels, compared, in_space))
        if not in_image and not in_space and compared.frames:
            yield from map(Remark, compared.remarks_on_parts())

    @staticmethod
    def _remarks_in_space(
        results: ScoredBoxes, labels: ScoredBoxes, compared: "_ComparedResults"
    ) -> tuple[Remark, ...]:
        """List sentences on sizes and places of 3D boxes."""
        num_3d = int(results.has_3d.sum())
        sizes = _of(_remarks_on_sizes(results, labels), "sizes" if num_3d >= MIN_MATCHES else "")
        places = _of(remarks_on_depths(results), "frame of the camera")
        if not places and (centres := (*remarks_on_centres(compared.frames),)):
            places = _of(centres, "centres" if rise_evenly(compared.frames) else "")
        return (*sizes, *(places or _of(remarks_on_offsets(compared.frames))))

    def _remarks_on_angles(
        self,
        results: ScoredBoxes,
        labels: ScoredBoxes,
        compared: "_ComparedResults",
        in_space: Sequence[Remark],
    ) -> Iterator[str]:
        """Yield sentences on alpha and rotation_y."""
        if self.lacking_alpha and self.without_alpha < self.total:
            yield (
                f"alpha of {self.without_alpha:,} of {self.total:,} results is {NO_ALPHA:g}, "
                "KITTI's number for none: orientation is scored only where all results have one, "
                f"those of other classes too; {ALPHA_REMEDY}, or leave these results out."
            )
        if not self.in_degrees:
            rotations = () if in_space else (*remarks_on_rotations(compared.frames),)
            doubt = doubt_about_labels(labels)
            if doubt is not None and (not self.without_alpha or rotations):
                yield f"{doubt}: scores of orientation compare it with results'; {ALPHA_REMEDY}."
                if np.ptp(labels.alphas):  # they tell that rotation_y of labels may be at fault
                    rotations = ()
            yield from rotations or (() if in_space else remarks_on_alphas(results))


def _of(texts: Iterable[str], convention: str = "") -> tuple[Remark, ...]:
    """List sentences as remarks on one convention."""
    return tuple(Remark(text, convention) for text in texts)


def _convention_of_scores(results: ScoredBoxes) -> str:
    """Convention of doubted scores; empty: a faulty sensor, or scores without bounds, may do it.

    A blank image gives the same boxes in every frame, also with one score.
    """
    if len(np.unique(results.boxes2d, axis=0)) < MIN_RESULTS:
        return ""
    if np.ptp(results.scores) == 0:
        return "equal scores"
    return "percent" if results.scores.max() > _LEAST_PERCENT else ""


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
            own = scale_of_sizes(expected, name)
            if own is not None and scale_of_sizes(written, name) is None:
                yield remark_on_scale([name], own, "labels")
            else:
                yield remark_on_scale([name], scale)


def _median(values: Float64[np.ndarray, "num 3"]) -> Float64[np.ndarray, "3"] | None:
    """Compute the median of the finite rows; None if they are too few."""
    finite = values[np.isfinite(values).all(axis=1)]
    return np.median(finite, axis=0) if len(finite) >= MIN_RESULTS else None


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

    def remarks_on_boxes2d(self) -> Iterator[Remark]:
        """Yield a sentence on 2D boxes, or whole frames, of another convention."""
        written = self._best_ious()
        readings = {
            f"2D boxes of results are probably {name}": self._best_ious(name)
            for name in BOX2D_CONVENTIONS
        }
        if best_reading(written, readings) is None:
            for name, kind in (("next frame", "before"), ("frame before", "after")):
                ious = self._best_ious(kind)
                better, worse = _num_better(ious, written), _num_better(written, ious)
                # between neighbouring frames of a drive only few boxes move
                if better >= _MIN_MOVED and is_clearly_better(better, worse, better + worse):
                    cause = f"results are probably those of the {name}"
                    yield Remark(_describe_reading(cause, written, ious))
                    return
        fit = fit_image(*self._pairs_in_image())
        if fit is not None:
            fitted = self._best_ious(fit=fit)
            if _num_better(fitted, written) >= MIN_MATCHES:
                cause = f"2D boxes of results are probably {OTHER_IMAGE} ({fit.describe()})"
                readings[cause] = fitted
        best = best_reading(written, readings)
        if best is not None:
            is_many = _num_better(readings[best], written) >= MIN_MATCHES
            convention = "2D boxes" if is_many and OTHER_IMAGE not in best else ""
            yield Remark(_describe_reading(best, written, readings[best]), convention)

    def _pairs_in_image(self) -> tuple[Boxes, Boxes]:
        """Pair the 2D boxes of labels with those of the surest results of their class."""
        pairs = [np.empty((2, 0, 4))]
        for every, labels in self.frames:
            most = max(_MIN_PAIRED, 2 * len(labels.names))
            is_sure = np.zeros(len(every.names), dtype=bool)
            is_sure[np.argsort(-every.scores, kind="stable")[:most]] = True
            results = every.select(is_sure)
            of_labels, of_results = np.nonzero(same_class(results, labels))
            pairs.append(np.stack((labels.boxes2d[of_labels], results.boxes2d[of_results])))
        expected, written = np.concatenate(pairs, axis=1)
        return expected, written

    def remarks_on_order(self) -> Iterator[str]:
        """Yield a sentence on scores that rank false results above true ones."""
        if not self.frames:
            return
        scores = np.concatenate([results.scores for results, _ in self.frames])
        is_hit = np.concatenate([_at_labels(*frame) for frame in self.frames])
        num_true, num_false = int(is_hit.sum()), int((~is_hit).sum())
        if min(num_true, num_false) < MIN_MATCHES:
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
            labels.has_3d[:, None] & results.has_3d & same_class(results, labels)
            for results, labels in self.frames
        ]
        in_space = np.concatenate(
            [
                space_ious(results, labels, possible).max(axis=1, initial=0)
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
        if num_2d >= MIN_MATCHES and num_3d < _CHANCE_SHARE * num_2d:
            yield (
                f"2D boxes of results match labels and 3D boxes do not: {counts}; look at "
                "location, sizes and rotation_y, and whether both are of the same frame."
            )
        elif num_3d >= MIN_MATCHES and num_2d < _CHANCE_SHARE * num_3d:
            yield (
                f"3D boxes of results match labels and 2D boxes do not: {counts}; look at x_min, "
                "y_min, x_max, y_max, and at the image's size."
            )

    def _best_ious(
        self, convention: str = "", fit: ImageFit | None = None
    ) -> Float64[np.ndarray, " num_labels"]:
        """Compute each label's largest IoU in the image with a result of its class.

        Args:
            convention: Name in `BOX2D_CONVENTIONS`; or `before` or `after`, for the results of a
                neighbouring frame; empty: results as they are written.
            fit: Image in whose pixels they are written, in place of a convention.
        """
        convert = BOX2D_CONVENTIONS.get(convention) if fit is None else fit.to_expected
        best = []
        frames = zip(self.frames, self.before, self.after, strict=True)
        for (own, labels), before, after in frames:
            results = {"before": before, "after": after}.get(convention, own)
            if results is None:
                best.append(np.zeros(len(labels.names)))
                continue
            boxes = results.boxes2d if convert is None else convert(results.boxes2d)
            ious = image_ious(labels.boxes2d[:, None], boxes[None])
            best.append((ious * same_class(results, labels)).max(axis=1, initial=0))
        return np.concatenate(best) if best else np.empty(0)


def _num_better(ious: Float64[np.ndarray, " num"], others: Float64[np.ndarray, " num"]) -> int:
    return int(matches_better(ious, others).sum())


def _describe_reading(
    cause: str, written: Float64[np.ndarray, " num"], ious: Float64[np.ndarray, " num"]
) -> str:
    return (
        f"{cause}: read so they match {_num_better(ious, written):,} of {len(written):,} labelled "
        f"objects clearly better in the image, and {_num_better(written, ious):,} worse; or labels "
        "are at fault."
    )


def _at_labels(results: ScoredBoxes, labels: ScoredBoxes) -> Bool[np.ndarray, " num_results"]:
    """Mask of the results at a labelled object of their class, in the image or in 3D."""
    ious = image_ious(labels.boxes2d[:, None], results.boxes2d[None])
    is_match = (ious >= MATCH_IOU) & same_class(results, labels)
    return np.asarray(
        (is_match | (ground_distances_m(results, labels) < MAX_DISTANCE_M)).any(axis=0)
    )

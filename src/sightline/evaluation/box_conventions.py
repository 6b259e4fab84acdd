"""Doubts about the boxes of results: sizes, corners and places in another convention."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from jaxtyping import Float64, Int64

from sightline.data.kitti_labels import NO_LOCATION, KittiObjects
from sightline.evaluation.kitti_object_rules import CLASSES, class_code

_FEWEST = 5  # objects of a class, with labels and results alike, whose medians tell anything
_CLEARLY = 0.5  # by how much the logarithms of three sizes fit better in another order
_NAMES: Final = ("height", "width", "length")


@dataclass(frozen=True, kw_only=True, slots=True)
class _Boxes:
    """Boxes of scored classes of one frame or of all."""

    codes: Int64[np.ndarray, " num_boxes"]
    scores: Float64[np.ndarray, " num_boxes"]
    """Zeros of labels."""
    boxes2d: Float64[np.ndarray, "num_boxes 4"]
    sizes_hwl: Float64[np.ndarray, "num_boxes 3"]
    """NaN without a 3D part, as the locations."""
    locations: Float64[np.ndarray, "num_boxes 3"]


@dataclass(slots=True)
class BoxConventions:
    """Boxes of results and labels over all frames, and what they have in common."""

    found: list[_Boxes] = field(default_factory=list)
    labelled: list[_Boxes] = field(default_factory=list)
    repeated: int = 0
    """Results that are there before in their frame, number for number."""

    def add(self, results: KittiObjects, labels: KittiObjects) -> None:
        """Keep the boxes of a frame."""
        found = _scored(results)
        self.found.append(found)
        self.labelled.append(_scored(labels))
        rows = np.column_stack((found.codes, found.scores, found.boxes2d, found.locations))
        self.repeated += len(rows) - len({row.tobytes() for row in rows})

    def remarks(self) -> Iterator[str]:
        """Sentences on what is probably of another convention."""
        if not self.found:
            return
        found, labelled = _joined(self.found), _joined(self.labelled)
        total = len(found.codes)
        if self.repeated:
            yield (
                f"WARNING: {self.repeated:,} of {total:,} results of scored classes are there "
                "twice in their frame: each but one counts as a false one."
            )
        inverted = int((found.boxes2d[:, 2:] < found.boxes2d[:, :2]).any(axis=1).sum())
        if inverted:
            yield (
                f"WARNING: {inverted:,} of {total:,} results of scored classes have 2D boxes that "
                "end before they begin and overlap nothing: KITTI's are x_min, y_min, x_max, "
                "y_max, not x, y, width, height."
            )
        if total and found.boxes2d.max() <= 1 and len(labelled.codes):
            yield (
                "WARNING: all 2D boxes of results lie within the first pixel and are probably "
                "shares of the image: KITTI's are in pixels."
            )
        yield from _remarks_on_sizes(found, labelled)
        yield from _remarks_on_places(found, labelled)


def _scored(objects: KittiObjects) -> _Boxes:
    codes = np.array([class_code(name) for name in objects.class_names], dtype=np.int64)
    kept = codes >= 0
    lacks = (objects.dimensions_hwl <= 0).any(axis=1)
    lacks |= (objects.locations == NO_LOCATION).any(axis=1)
    sizes = np.where(lacks[:, None], np.nan, objects.dimensions_hwl)
    locations = np.where(lacks[:, None], np.nan, objects.locations)
    scores = np.zeros(len(codes)) if objects.scores is None else objects.scores
    return _Boxes(
        codes=codes[kept],
        scores=scores[kept],
        boxes2d=objects.boxes2d[kept],
        sizes_hwl=sizes[kept],
        locations=locations[kept],
    )


def _joined(frames: list[_Boxes]) -> _Boxes:
    return _Boxes(
        codes=np.concatenate([each.codes for each in frames]),
        scores=np.concatenate([each.scores for each in frames]),
        boxes2d=np.concatenate([each.boxes2d for each in frames]),
        sizes_hwl=np.concatenate([each.sizes_hwl for each in frames]),
        locations=np.concatenate([each.locations for each in frames]),
    )


def _median(values: np.ndarray) -> np.ndarray | None:
    """Median row of those that are finite; None where they are too few."""
    finite = values[np.isfinite(values).all(axis=1)]
    return np.median(finite, axis=0) if len(finite) >= _FEWEST else None


def _remarks_on_sizes(found: _Boxes, labelled: _Boxes) -> Iterator[str]:
    """A sentence for each class whose sizes are the labels' in another order."""
    for code, name in enumerate(CLASSES):
        ours = _median(found.sizes_hwl[found.codes == code])
        theirs = _median(labelled.sizes_hwl[labelled.codes == code])
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


def _remarks_on_places(found: _Boxes, labelled: _Boxes) -> Iterator[str]:
    ours, theirs = _median(found.locations), _median(labelled.locations)
    sizes_hwl = _median(labelled.sizes_hwl)
    if ours is None or theirs is None or sizes_hwl is None:
        return
    depths = found.locations[np.isfinite(found.locations).all(axis=1), 2]
    behind = int((depths < 0).sum())
    if behind > len(depths) / 2:
        yield (
            f"WARNING: {behind:,} of {len(depths):,} 3D boxes of results lie behind the camera: "
            "x, y, z of KITTI's files are in the camera's frame (right, down, forward), not in "
            "the LiDAR's."
        )
    elif abs((ours[1] - theirs[1]) / sizes_hwl[0] + 0.5) < 0.15:
        yield (
            f"WARNING: 3D boxes of results lie {theirs[1] - ours[1]:.2f} m above those of labels, "
            "half their height: their y is probably that of the centre, KITTI's is that of the "
            "bottom."
        )

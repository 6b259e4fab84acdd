"""Reduction of each frame's objects to the input of KITTI's matching.

Boxes are dropped once their overlaps are known: memory grows with the number of objects that can
take part in a match, some dozens of bytes each.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int8, Int32, Int64

from sightline.data.formats.kitti_labels import NO_ALPHA, NO_LOCATION, KittiObjects
from sightline.evaluation.centre_pairs import find_centre_pairs
from sightline.evaluation.kitti_object_overlaps import (
    ground_and_space_cover,
    ground_and_space_overlap,
    image_cover,
    image_overlap,
)
from sightline.evaluation.kitti_object_rules import (
    CLASSES,
    DONT_CARE,
    METRICS,
    NEVER,
    OTHER_CLASS,
    class_code,
    detection_levels,
    neighbour_code,
    truth_levels,
)
from sightline.ops.compiled import compiled


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class MatchingData:
    """Truths, detections and sufficiently overlapping pairs of consecutive frames.

    Truths are the labelled objects of the evaluated classes and of their neighbours. Detections
    are those of the evaluated classes, and small ones of any. A truth and a detection are a pair
    if one may match the other and they overlap enough by one of the metrics. All in file order.
    """

    truths_per_frame: Int32[np.ndarray, " num_frames"]
    detections_per_frame: Int32[np.ndarray, " num_frames"]
    truth_class: Int8[np.ndarray, " num_truths"]
    """Index in CLASSES; a neighbouring class has that of its evaluated class."""
    truth_level: Int8[np.ndarray, " num_truths"]
    """First difficulty at which the truth counts, or NEVER."""
    truth_range_m: Float64[np.ndarray, " num_truths"]
    """Horizontal distance from the camera; NaN without a location."""
    pairs_per_truth: Int32[np.ndarray, " num_truths"]
    detection_class: Int8[np.ndarray, " num_detections"]
    """Index in CLASSES, or a negative number."""
    detection_level: Int8[np.ndarray, " num_detections"]
    """First difficulty at which the detection is not small, or NEVER."""
    detection_range_m: Float64[np.ndarray, " num_detections"]
    """Horizontal distance, as for truths."""
    detection_score: Float64[np.ndarray, " num_detections"]
    detection_forgiven: Bool[np.ndarray, "num_detections 3"]
    """Whether a DontCare region covers the detection, by metric."""
    pair_detection: Int32[np.ndarray, " num_pairs"]
    """Index of the detection among those of its frame."""
    pair_overlap: Float64[np.ndarray, "num_pairs 3"]
    """Overlap by metric."""
    pair_similarity: Float64[np.ndarray, " num_pairs"]
    """Similarity of the headings: (1 + cos(difference of alpha)) / 2."""
    centres_per_detection: Int32[np.ndarray, " num_detections"]
    """Number of truths of the class whose centres are near, whether they overlap or not."""
    centre_truth: Int32[np.ndarray, " num_centre_pairs"]
    """Index of such a truth among those of its frame."""
    centre_errors: Float64[np.ndarray, "num_centre_pairs 3"]
    """Distance of the centres [m], scale error, heading error [rad]; see `find_centre_pairs`."""
    is_evaluated: Bool[np.ndarray, "3 3"]
    """Whether some detection has the metric's values, by class and metric."""
    has_headings: Bool[np.ndarray, "1"]
    """Whether all detections have an observation angle."""

    @property
    def num_frames(self) -> int:
        """Number of frames."""
        return len(self.truths_per_frame)


def concatenate(parts: Sequence[MatchingData]) -> MatchingData:
    """Join the frames of all parts, in their order."""
    columns = {
        field.name: np.concatenate([getattr(part, field.name) for part in parts])
        for field in fields(MatchingData)
        if field.name not in ("is_evaluated", "has_headings")
    }
    return MatchingData(
        **columns,
        is_evaluated=np.logical_or.reduce([part.is_evaluated for part in parts]),
        has_headings=np.logical_and.reduce([part.has_headings for part in parts]),
    )


def find_pairs(
    detections: Sequence[KittiObjects],
    labels: Sequence[KittiObjects],
    overlaps: Float64[np.ndarray, "3 3"],
) -> MatchingData:
    """Prepare frames for matching.

    Args:
        detections: One record per frame, with scores.
        labels: One record per frame, in the same order.
        overlaps: Overlaps that a match must exceed, by class and metric.

    Raises:
        ValueError: If the numbers of frames differ or are 0, or detections have no scores.
    """
    if len(detections) != len(labels) or not labels:
        raise ValueError(
            f"got detections of {len(detections)} frames and labels of {len(labels)}: give one "
            "record of each for every frame, and at least one frame"
        )
    if any(frame.scores is None for frame in detections):
        raise ValueError("detections have no scores: give result records, not label records")
    boxes, codes = stack_boxes(detections), _codes(detections)
    truths, found = _select_truths(labels), _select_detections(detections, boxes, codes)
    capacity = int((np.diff(truths.offsets) * np.diff(found.offsets)).sum())
    pairs_per_truth = np.zeros(len(truths.code), dtype=np.int32)
    pair_detection = np.empty(capacity, dtype=np.int32)
    pair_overlap = np.empty((capacity, len(METRICS)))
    pair_similarity = np.empty(capacity)
    num_pairs = _fill_pairs(
        truths, found, overlaps, pairs_per_truth, pair_detection, pair_overlap, pair_similarity
    )
    centres = find_centre_pairs(
        found.boxes, found.code, found.offsets, truths.boxes, truths.code, truths.offsets
    )
    regions, region_offsets = _select_regions(labels)
    forgiven = _find_forgiven(found, regions, region_offsets, overlaps)
    return MatchingData(
        truths_per_frame=np.diff(truths.offsets).astype(np.int32),
        detections_per_frame=np.diff(found.offsets).astype(np.int32),
        truth_class=truths.code,
        truth_level=truths.level,
        truth_range_m=_ranges_m(truths.boxes),
        pairs_per_truth=pairs_per_truth,
        detection_class=found.code,
        detection_level=found.level,
        detection_range_m=_ranges_m(found.boxes),
        detection_score=found.score,
        detection_forgiven=forgiven,
        pair_detection=pair_detection[:num_pairs].copy(),
        pair_overlap=pair_overlap[:num_pairs].copy(),
        pair_similarity=pair_similarity[:num_pairs].copy(),
        centres_per_detection=centres[0],
        centre_truth=centres[1],
        centre_errors=centres[2],
        is_evaluated=find_evaluated(boxes, codes),
        has_headings=np.array([all((each.alpha != NO_ALPHA).all() for each in detections)]),
    )


def stack_boxes(frames: Sequence[KittiObjects]) -> Float64[np.ndarray, "num_objects 11"]:
    """Stack the boxes of frames in the format of `kitti_object_overlaps`."""
    columns = (
        np.concatenate([frame.boxes2d for frame in frames]),
        np.concatenate([frame.dimensions_hwl for frame in frames]),
        np.concatenate([frame.locations for frame in frames]),
        np.concatenate([frame.rotation_y for frame in frames])[:, None],
    )
    return np.concatenate(columns, axis=1)


def find_evaluated(
    boxes: Float64[np.ndarray, "num_objects 11"], codes: Int8[np.ndarray, " num_objects"]
) -> Bool[np.ndarray, "3 3"]:
    """Test by class and metric whether a detection of the class has the metric's values.

    A class is evaluated by a metric only if one has, in the whole submission.
    """
    height, width, length, x, y, z = boxes[:, 4:10].T
    on_ground = (x != NO_LOCATION) & (z != NO_LOCATION) & (width > 0) & (length > 0)
    in_space = on_ground & (y != NO_LOCATION) & (height > 0)
    has_values = np.stack((boxes[:, 0] >= 0, on_ground, in_space), axis=1)
    return np.stack([has_values[codes == code].any(axis=0) for code in range(len(CLASSES))])


class _Truths(NamedTuple):
    """Labelled objects of evaluated classes and of their neighbours."""

    boxes: Float64[np.ndarray, "num_truths 11"]
    alpha: Float64[np.ndarray, " num_truths"]
    code: Int8[np.ndarray, " num_truths"]
    level: Int8[np.ndarray, " num_truths"]
    offsets: Int64[np.ndarray, " num_offsets"]


class _Detections(NamedTuple):
    """Detections of evaluated classes, and small ones of any class."""

    boxes: Float64[np.ndarray, "num_detections 11"]
    alpha: Float64[np.ndarray, " num_detections"]
    code: Int8[np.ndarray, " num_detections"]
    level: Int8[np.ndarray, " num_detections"]
    score: Float64[np.ndarray, " num_detections"]
    offsets: Int64[np.ndarray, " num_offsets"]


def _select_truths(labels: Sequence[KittiObjects]) -> _Truths:
    codes, neighbours = _codes(labels), _neighbours(labels)
    boxes = stack_boxes(labels)
    levels = truth_levels(
        np.concatenate([frame.truncation for frame in labels]),
        np.concatenate([frame.occlusion for frame in labels]),
        boxes[:, :4],
    )
    levels[neighbours != OTHER_CLASS] = NEVER
    codes = np.maximum(codes, neighbours)
    kept = np.flatnonzero(codes >= 0)
    return _Truths(
        boxes=boxes[kept],
        alpha=np.concatenate([frame.alpha for frame in labels])[kept],
        code=codes[kept],
        level=levels[kept],
        offsets=_offsets(labels, kept),
    )


def _select_detections(
    detections: Sequence[KittiObjects],
    boxes: Float64[np.ndarray, "num_objects 11"],
    codes: Int8[np.ndarray, " num_objects"],
) -> _Detections:
    levels = detection_levels(boxes[:, :4])
    kept = np.flatnonzero((codes >= 0) | (levels > 0))
    scores = [frame.scores for frame in detections if frame.scores is not None]
    return _Detections(
        boxes=boxes[kept],
        alpha=np.concatenate([frame.alpha for frame in detections])[kept],
        code=codes[kept],
        level=levels[kept],
        score=np.concatenate(scores)[kept],
        offsets=_offsets(detections, kept),
    )


def _select_regions(
    labels: Sequence[KittiObjects],
) -> tuple[Float64[np.ndarray, "num_regions 11"], Int64[np.ndarray, " num_offsets"]]:
    kept = np.flatnonzero(_codes(labels) == DONT_CARE)
    return stack_boxes(labels)[kept], _offsets(labels, kept)


def _ranges_m(boxes: Float64[np.ndarray, "num_objects 11"]) -> Float64[np.ndarray, " num_objects"]:
    x, z = boxes[:, 7], boxes[:, 9]
    return np.where((x == NO_LOCATION) | (z == NO_LOCATION), np.nan, np.hypot(x, z))


def _codes(frames: Sequence[KittiObjects]) -> Int8[np.ndarray, " num_objects"]:
    return np.array([class_code(name) for frame in frames for name in frame.class_names], np.int8)


def _neighbours(frames: Sequence[KittiObjects]) -> Int8[np.ndarray, " num_objects"]:
    names = (name for frame in frames for name in frame.class_names)
    return np.array([neighbour_code(name) for name in names], np.int8)


def _offsets(
    frames: Sequence[KittiObjects], kept: Int64[np.ndarray, " num_kept"]
) -> Int64[np.ndarray, " num_offsets"]:
    """Compute the start of each frame's kept objects, and the end of the last one's."""
    starts = np.cumsum([0, *(len(frame) for frame in frames)])
    return np.searchsorted(kept, starts)


@compiled
def _fill_pairs(
    truths: _Truths,
    found: _Detections,
    overlaps: Float64[np.ndarray, "3 3"],
    pairs_per_truth: Int32[np.ndarray, " num_truths"],
    pair_detection: Int32[np.ndarray, " capacity"],
    pair_overlap: Float64[np.ndarray, "capacity 3"],
    pair_similarity: Float64[np.ndarray, " capacity"],
) -> int:
    """Write the pairs into the last four arrays and return their number."""
    num_pairs = 0
    for frame in range(len(truths.offsets) - 1):
        first = found.offsets[frame]
        for i in range(truths.offsets[frame], truths.offsets[frame + 1]):
            code = truths.code[i]
            before = num_pairs
            for j in range(first, found.offsets[frame + 1]):
                if found.code[j] != code and found.level[j] == 0:
                    continue
                image = image_overlap(found.boxes[j], truths.boxes[i])
                ground, space = ground_and_space_overlap(found.boxes[j], truths.boxes[i])
                if (
                    image > overlaps[code, 0]
                    or ground > overlaps[code, 1]
                    or space > overlaps[code, 2]
                ):
                    pair_detection[num_pairs] = j - first
                    pair_overlap[num_pairs, 0] = image
                    pair_overlap[num_pairs, 1] = ground
                    pair_overlap[num_pairs, 2] = space
                    difference = truths.alpha[i] - found.alpha[j]
                    pair_similarity[num_pairs] = (1.0 + np.cos(difference)) / 2.0
                    num_pairs += 1
            pairs_per_truth[i] = num_pairs - before
    return num_pairs


@compiled
def _find_forgiven(
    found: _Detections,
    regions: Float64[np.ndarray, "num_regions 11"],
    region_offsets: Int64[np.ndarray, " num_offsets"],
    overlaps: Float64[np.ndarray, "3 3"],
) -> Bool[np.ndarray, "num_detections 3"]:
    """Test by metric which detections a DontCare region covers by more than the class's overlap.

    A region forgives any number of detections, so one test of each is enough.
    """
    forgiven = np.zeros((len(found.code), 3), dtype=np.bool_)
    for frame in range(len(region_offsets) - 1):
        for j in range(found.offsets[frame], found.offsets[frame + 1]):
            code = found.code[j]
            if code < 0:
                continue
            for i in range(region_offsets[frame], region_offsets[frame + 1]):
                ground, space = ground_and_space_cover(found.boxes[j], regions[i])
                forgiven[j, 0] |= image_cover(found.boxes[j], regions[i]) > overlaps[code, 0]
                forgiven[j, 1] |= ground > overlaps[code, 1]
                forgiven[j, 2] |= space > overlaps[code, 2]
    return forgiven

"""KITTI's scores of matched frames: precision by slot, AP and AOS, in all or by distance."""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float64, Int64

from sightline.evaluation.bootstrap import PERCENTILES, draw_frames
from sightline.evaluation.centre_distance import score_centres, select_centres
from sightline.evaluation.kitti_object_matching import (
    MatchingTask,
    count_at,
    find_thresholds,
    index_pairs,
    match_by_score,
    select,
)
from sightline.evaluation.kitti_object_pairs import MatchingData
from sightline.evaluation.kitti_object_resampling import ResampledCurve
from sightline.evaluation.kitti_object_rules import (
    CLASSES,
    DIFFICULTIES,
    METRICS,
    NEVER,
    ClassName,
    Difficulty,
    Metric,
    MinimumOverlaps,
)
from sightline.evaluation.object_report import BootstrapAP, DistanceBand, ObjectEntry, ObjectReport
from sightline.structures.score_curves import NUM_SLOTS


def score_objects(
    data: MatchingData, overlaps: MinimumOverlaps, *, bootstrap: int = 0, seed: int = 0
) -> ObjectReport:
    """Score all classes, metrics and difficulties for which there are detections.

    Args:
        data: All frames, their pairs found with the same overlaps.
        overlaps: Overlaps that a match must exceed.
        bootstrap: Resamples of the frames for the intervals of AP over all scores and of AP by
            centre distance; 0: without.
        seed: Seed of the resamples, which are the same for all entries.
    """
    index = index_pairs(data)
    minima = overlaps.as_array()
    entries = []
    for code, class_name in enumerate(CLASSES):
        for metric_index, metric in enumerate(METRICS):
            if not data.is_evaluated[code, metric_index]:
                continue
            for level, difficulty in enumerate(DIFFICULTIES):
                task = select(
                    data,
                    index,
                    code=code,
                    metric=metric_index,
                    difficulty=level,
                    min_overlap=float(minima[code, metric_index]),
                )
                entry = _score(
                    task,
                    class_name,
                    metric,
                    difficulty,
                    with_headings=bool(data.has_headings.all()),
                    all_points=_bootstrap(task, bootstrap, seed),
                )
                if metric == "3d":
                    near = select_centres(data, index, code=code, difficulty=level)
                    scores = score_centres(near, bootstrap=bootstrap, seed=seed)
                    entry = replace(entry, centres=scores)
                entries.append(entry)
    return ObjectReport(frames=data.num_frames, entries=tuple(entries), num_resamples=bootstrap)


def score_by_distance(
    data: MatchingData, overlaps: MinimumOverlaps, edges_m: Sequence[float]
) -> tuple[DistanceBand, ...]:
    """Score each band of horizontal distances from the camera separately: no measure of KITTI's.

    A band counts its objects and, as false positives, its detections without any match. An object
    in another band may be found, but is not missed, and a false detection counts in its own band.

    Args:
        data: All frames, their pairs found with the same overlaps.
        overlaps: Overlaps that a match must exceed.
        edges_m: Borders between bands, ascending; the first band begins at 0 and the last has no
            end.

    Raises:
        ValueError: The edges are not ascending from above 0, or a detection has no location.
    """
    check_edges(edges_m)
    if np.isnan(data.detection_range_m).any():
        raise ValueError(
            "scores by distance need detections with 3D locations, and some have none (-1000); "
            "leave the distances out"
        )
    return tuple(
        DistanceBand(from_m=low, to_m=high, entries=_band(data, overlaps, low, high))
        for low, high in pairwise((0.0, *edges_m, math.inf))
    )


def check_edges(edges_m: Sequence[float]) -> None:
    """Check the edges of bands.

    Raises:
        ValueError: They are not ascending from above 0, or one is not finite.
    """
    if not all(low < high < math.inf for low, high in pairwise((0.0, *edges_m))):
        values = ", ".join(f"{edge:g}" for edge in edges_m)
        raise ValueError(f"distances must rise from above 0 and be finite, got {values}")


def _band(
    data: MatchingData, overlaps: MinimumOverlaps, low_m: float, high_m: float
) -> tuple[ObjectEntry, ...]:
    is_counted, is_found = (
        (low_m <= ranges_m) & (ranges_m < high_m)
        for ranges_m in (data.truth_range_m, data.detection_range_m)
    )
    banded = replace(
        data,
        truth_level=np.where(is_counted, data.truth_level, NEVER).astype(np.int8),
        detection_forgiven=data.detection_forgiven | ~is_found[:, None],
    )
    return score_objects(banded, overlaps).entries


def _score(
    task: MatchingTask,
    class_name: ClassName,
    metric: Metric,
    difficulty: Difficulty,
    *,
    with_headings: bool,
    all_points: BootstrapAP | None,
) -> ObjectEntry:
    thresholds = find_thresholds(match_by_score(task).scores, task.n_gt)
    counts = count_at(task, thresholds)
    positives = counts.tp + counts.fp
    precision = _fill_slots(counts.tp.astype(np.float64), positives)
    orientation = _fill_slots(counts.similarity, positives)
    with_aos = with_headings and metric == "bbox"
    found = int(counts.tp[-1]) if len(thresholds) else 0
    return ObjectEntry(
        class_name=class_name,
        metric=metric,
        difficulty=difficulty,
        n_gt=task.n_gt,
        max_recall=float(counts.tp.max(initial=0)) / task.n_gt if task.n_gt else 0.0,
        ap_r11=_mean_r11(precision),
        ap_r40=_mean_r40(precision),
        aos_r11=_mean_r11(orientation) if with_aos else None,
        aos_r40=_mean_r40(orientation) if with_aos else None,
        precision=precision,
        thresholds=thresholds,
        tp=counts.tp,
        fp=counts.fp,
        fn=counts.fn,
        flipped_share=int(counts.flipped[-1]) / found if with_headings and found else None,
        all_points=all_points,
    )


def _fill_slots(
    hits: Float64[np.ndarray, " num_thresholds"], positives: Int64[np.ndarray, " num_thresholds"]
) -> Float64[np.ndarray, "41"]:
    """Divide hits by positives, raise each slot to the best later one; unreached slots are 0.

    0 / 0, which the official program prints as nan, is 0.
    """
    slots = np.zeros(NUM_SLOTS)
    np.divide(hits, positives, out=slots[: len(hits)], where=positives > 0)
    return np.maximum.accumulate(slots[::-1])[::-1].copy()


def _mean_r11(slots: Float64[np.ndarray, "41"]) -> float:
    return 100 * float(slots[::4].mean())


def _mean_r40(slots: Float64[np.ndarray, "41"]) -> float:
    return 100 * float(slots[1:].mean())


def _bootstrap(task: MatchingTask, num_resamples: int, seed: int) -> BootstrapAP | None:
    """Compute AP over all scores, with a percentile interval (Efron 1979) over resampled frames.

    It is None if no object counts. There is no interval of fewer than `MIN_FRAMES` frames, or
    without resamples with such an object.
    """
    if task.n_gt == 0:
        return None
    curve = ResampledCurve.of(task)
    ap = curve.ap_all_points(np.ones(curve.num_frames, dtype=np.int64))
    drawn = draw_frames(task.valid_per_frame, num_resamples, seed)
    resampled = [curve.ap_all_points(weights) for weights in drawn]
    if not resampled:
        return BootstrapAP(ap=ap)
    low, high = np.percentile(resampled, PERCENTILES)
    return BootstrapAP(ap=ap, low=float(low), high=float(high))

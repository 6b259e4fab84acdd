"""Outcomes of detections, and calibration errors of their scores."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64

from sightline.evaluation.kitti_object_matching import MatchingTask, pick_by_overlap
from sightline.ops.compiled import compiled
from sightline.structures.reliability import Reliability


class Outcomes(NamedTuple):
    """Detections that count at a threshold, in file order: true and false ones."""

    score: Float64[np.ndarray, " num_detections"]
    is_true: Bool[np.ndarray, " num_detections"]
    overlap: Float64[np.ndarray, " num_detections"]
    """Overlap with the matched object; 0 if false."""


def find_outcomes(task: MatchingTask, min_score: float) -> Outcomes:
    """Classify each detection of `min_score` or more, by KITTI's pass 2 at that threshold.

    Detections that are neither true nor false are left out: those on objects ignored at the
    difficulty, in DontCare regions, and small ones.
    """
    truth_of = _find_matches(task, min_score)
    takes = truth_of >= 0
    pairs = truth_of[takes]
    truths = np.searchsorted(task.pair_offsets, pairs, side="right") - 1
    is_true = np.zeros(len(takes), dtype=np.bool_)
    is_true[takes] = task.truth_valid[truths]
    is_true &= task.detection_normal
    overlap = np.zeros(len(takes))
    overlap[takes] = task.pair_overlap[pairs]
    is_false = task.detection_false & ~takes & (task.detection_score >= min_score)
    counts = np.flatnonzero(is_true | is_false)
    return Outcomes(
        score=task.detection_score[counts],
        is_true=is_true[counts],
        overlap=np.where(is_true, overlap, 0.0)[counts],
    )


def find_reliability(
    scores: Float64[np.ndarray, " num_detections"],
    targets: Float64[np.ndarray, " num_detections"],
    num_bins: int,
) -> Reliability:
    """Compute mean score and mean target of the detections in score bins of equal width.

    The result's `error` is, for the targets
    * 1 for true detections and 0 for false ones: D-ECE by score, Kueppers et al. 2020,
      "Multivariate confidence calibration for object detection", eq. 5 with no dimension but the
      score;
    * the overlap of true detections and 0 for false ones: LaECE of one class, Oksuz et al. 2023,
      "Towards building self-aware object detectors", eq. 4: precision times mean overlap is the
      mean of these.

    Args:
        scores: In [0, 1].
        targets: In [0, 1].
        num_bins: At least 1.
    """
    bins = np.minimum((scores * num_bins).astype(np.int64), num_bins - 1)
    counts = np.bincount(bins, minlength=num_bins)
    with np.errstate(invalid="ignore"):
        mean_score = np.bincount(bins, weights=scores, minlength=num_bins) / counts
        mean_target = np.bincount(bins, weights=targets, minlength=num_bins) / counts
    return Reliability(counts=counts, mean_score=mean_score, mean_target=mean_target)


@compiled
def _find_matches(task: MatchingTask, min_score: float) -> Int64[np.ndarray, " num_detections"]:
    """Find for each detection the pair of its matched truth, or -1."""
    taken = np.full(len(task.detection_score), -1, dtype=np.int32)
    pair_of = np.full(len(task.detection_score), -1, dtype=np.int64)
    for i in range(len(task.truth_valid)):
        pair = pick_by_overlap(task, i, min_score, taken, 0)
        if pair >= 0:
            taken[task.pair_detection[pair]] = 0
            pair_of[task.pair_detection[pair]] = pair
    return pair_of

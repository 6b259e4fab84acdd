"""Outcomes of detections, calibration errors of their scores, and the optimal LRP error.

Oksuz et al. 2018, "Localization Recall Precision (LRP): a new performance metric for object
detection", and Oksuz et al. 2021, "One metric to measure them all", eq. 1, 2 and 8 to 10.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64

from sightline.evaluation.kitti_object_matching import FrameSteps, MatchingTask, pick_by_overlap
from sightline.ops.compiled import compiled
from sightline.structures.score_curves import Reliability


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


@dataclass(frozen=True, kw_only=True, slots=True)
class OptimalLrp:
    """Minimum error over all score thresholds, with its components. All in [0, 1]."""

    error: float
    """oLRP; 1 if no true positive is found at any threshold."""
    threshold: float | None
    """Score threshold of the minimum, the highest one; None if an empty result is no worse."""
    localization: float | None
    """Mean of 1 - IoU over the true positives at this threshold; None if there are none."""
    false_positives: float | None
    """1 - precision at this threshold; None if nothing is found."""
    false_negatives: float
    """1 - recall at this threshold."""


def optimal_lrp(steps: FrameSteps, n_gt: int, min_overlap: float) -> OptimalLrp | None:
    """Compute the minimum LRP error over the thresholds at which counts change.

    LRP = (sum of (1 - IoU) / (1 - `min_overlap`) over true positives + false positives + misses) /
    (true positives + false positives + misses). An object covered only by a detection below the
    difficulty's height is a miss here, as in the AP over all points.

    Args:
        steps: Steps of all frames, highest score first.
        n_gt: Number of objects that count.
        min_overlap: Overlap that a match exceeds; in [0, 1).

    Returns:
        None without objects.
    """
    if n_gt == 0:
        return None
    ends = np.flatnonzero(np.diff(steps.score, append=-np.inf))  # the last step of each score
    tp, fp = np.cumsum(steps.tp)[ends], np.cumsum(steps.fp)[ends]
    overlap = np.cumsum(steps.overlap)[ends]
    misplaced = (tp - overlap) / (1 - min_overlap)
    errors = (misplaced + fp + (n_gt - tp)) / (fp + n_gt)
    best = int(errors.argmin()) if len(errors) else -1
    if best < 0 or errors[best] >= 1:
        return OptimalLrp(
            error=1.0, threshold=None, localization=None, false_positives=None, false_negatives=1.0
        )
    found = int(tp[best])
    return OptimalLrp(
        error=float(errors[best]),
        threshold=float(steps.score[ends[best]]),
        localization=float(1 - overlap[best] / found) if found else None,
        false_positives=float(fp[best] / (found + fp[best])),
        false_negatives=float(1 - found / n_gt),
    )


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

"""Optimal Localization Recall Precision: one error for boxes, false alarms and misses.

Oksuz et al. 2018, "Localization Recall Precision (LRP): a new performance metric for object
detection", and Oksuz et al. 2021, "One metric to measure them all", eq. 1, 2 and 8 to 10.
"""

from dataclasses import dataclass

import numpy as np

from sightline.evaluation.kitti_object_matching import FrameSteps


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

"""Precision-recall curves by the rules of KITTI's object evaluation, and reliability of scores."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

NUM_SLOTS = 41
"""Recall positions: 0, 1/40, ..., 1."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PrecisionRecall:
    """Precision-recall curve of one class, metric and difficulty; from 0 to 1, AP in percent.

    It has two forms. The measured form is a point for each threshold. AP is the mean over the
    slots: the points in order, each at the next recall position, regardless of its recall. With
    fewer objects than positions the slots end before the measured recall does.
    """

    recall: Float64[np.ndarray, " num_thresholds"]
    """Share of the objects found at each threshold, scores descending."""
    precision: Float64[np.ndarray, " num_thresholds"]
    """Share of true detections at each threshold; 0 if no detection counts."""
    slots: Float64[np.ndarray, "41"]
    """Best precision of this and later thresholds, by recall position; 0 if none is left."""
    ap_r40: float
    """Mean of the slots 1 to 40, percent."""
    ap_r11: float
    """Mean of the slots 0, 4, ..., 40, percent."""
    num_objects: int
    """Number of labelled objects that count."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Reliability:
    """Detections by score, in bins of equal width over [0, 1]; a bin includes its lower edge.

    Raises:
        ValueError: The columns have different lengths.
    """

    counts: Int64[np.ndarray, " num_bins"]
    mean_score: Float64[np.ndarray, " num_bins"]
    """Mean score of each bin; NaN: the bin is empty."""
    mean_target: Float64[np.ndarray, " num_bins"]
    """Mean target of the score: the share of true detections, or their mean overlap times that
    share. NaN: the bin is empty."""

    def __post_init__(self) -> None:
        """Check that the columns have equal lengths."""
        if not len(self.counts) == len(self.mean_score) == len(self.mean_target):
            raise ValueError(
                f"bins need columns of one length, got {len(self.counts)}, {len(self.mean_score)} "
                f"and {len(self.mean_target)}"
            )

    @property
    def num_bins(self) -> int:
        """Number of bins."""
        return len(self.counts)

    @property
    def error(self) -> float | None:
        """Mean distance of score and target, weighted by the bins' counts; None: no detections."""
        filled = self.counts > 0
        total = int(self.counts.sum())
        if total == 0:
            return None
        distances = np.abs(self.mean_score[filled] - self.mean_target[filled])
        return float(self.counts[filled] @ distances) / total

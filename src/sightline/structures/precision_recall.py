"""Precision-recall curves by the rules of KITTI's object evaluation."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

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

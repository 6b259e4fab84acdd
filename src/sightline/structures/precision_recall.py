"""Precision over recall, as KITTI's object evaluation counts both."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

NUM_SLOTS = 41
"""Recall positions: 0, 1/40, ..., 1."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PrecisionRecall:
    """The curve of one class, metric and difficulty; all from 0 to 1, but for the percentages.

    It has two forms. What was measured is a point for each threshold. What AP is the mean of are
    the slots: the points in turn, each at the next recall position, whatever recall it has. With
    fewer objects than positions the slots end before the measured recall does.
    """

    recall: Float64[np.ndarray, " num_thresholds"]
    """Share of the objects that are found at each threshold, scores descending."""
    precision: Float64[np.ndarray, " num_thresholds"]
    """Share of the detections there that are true; 0 where none counts."""
    slots: Float64[np.ndarray, "41"]
    """The best precision of this and later thresholds, by recall position; 0 where none is left."""
    ap_r40: float
    """Mean of the slots 1 to 40, percent."""
    ap_r11: float
    """Mean of the slots 0, 4, ..., 40, percent."""
    num_objects: int
    """Labelled objects that count."""

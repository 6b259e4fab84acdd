"""Calibrated scores: Kull et al. 2017 (beta calibration), eq. 5."""

import numpy as np

from kitti_frame import Steps


def beta(slopes: Steps, score: float) -> float:
    """Map a score by beta calibration."""
    score = min(max(score, 1e-9), 1 - 1e-9)
    logit = slopes["low"] * np.log(score) - slopes["high"] * np.log1p(-score) + slopes["bias"]
    return float(1 / (1 + np.exp(-logit.clip(-50, 50))))

"""Adaptation of simulated truth to measured truth: widened contours and pixel weights."""

import math
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from jaxtyping import Float32
from numpy import ndarray

_NO_TRUTH_M = 200.0  # value of pixels without truth, such as the sky
_CONTOUR_RATIO = 0.05  # relative depth step of a contour, beyond the slope of the ground
_GROUND_SLOPE = 0.0016  # inverse depth [1/m] per row of KITTI's images; twice a level road's
_THIN_PX, _THIN_RATIO = 9, 1.05
_NEAR_PX = 7  # side of the square around a measurement that counts as near


@dataclass(frozen=True, kw_only=True)
class TruthShaping:
    """Changes and pixel weights of dense simulated truth for training.

    The truth of real frames is accumulated from several sweeps: most of it lies near measurements,
    almost none on twigs or behind fences, and near surfaces are a pixel or two too wide.
    """

    in_reach: bool = False
    """Whether truth above the highest measurement of the columns around, of all beams, is left
    out, in training and for scores."""
    contours_px: int = 0
    """Number of pixels by which near surfaces are widened at contours."""
    contours_within_m: float = 20.0
    """Distance beyond which surfaces are widened by one pixel at most."""
    thin_weight: float = 1.0
    """Weight of pixels on or beside objects thinner than nine pixels."""
    away_weight: float = 1.0
    """Weight of pixels more than three pixels from any measurement of all beams."""
    kept_weight: float = 1.0
    """Weight of measurements that the classical completion keeps and predictors may restore."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        if self.contours_px < 0:
            raise ValueError(f"contours_px must be at least 0, got {self.contours_px}")
        for name in ("contours_within_m", "thin_weight", "away_weight", "kept_weight"):
            value = getattr(self, name)
            if not 0 <= value < math.inf:
                raise ValueError(f"{name} must be at least 0 and finite, got {value}")


AS_SIMULATED: Final = TruthShaping()
"""Unchanged truth with equal pixel weights."""


def widen_near_surfaces(
    truth_m: Float32[ndarray, "height width"], shaping: TruthShaping
) -> Float32[ndarray, "height width"]:
    """Widen near surfaces at contours by up to `contours_px`; pixels without truth stay so.

    A pixel is at a contour if truth around it is nearer by more than 5 % plus the slope of the
    ground.
    """
    if not shaping.contours_px:
        return truth_m
    filled = _fill_missing(truth_m)
    narrow, wide = (_nearest_around(filled, px) for px in (1, shaping.contours_px))
    nearest = np.where(wide < shaping.contours_within_m, wide, narrow)
    slope = np.float32(_GROUND_SLOPE * (2 * shaping.contours_px + 1) / 2)
    is_contour = 1 / nearest - 1 / filled > slope + np.float32(_CONTOUR_RATIO) / filled
    return np.where((truth_m > 0) & is_contour, nearest, truth_m)


def pixel_weights(
    truth_m: Float32[ndarray, "height width"],
    sparse_m: Float32[ndarray, "height width"],
    filled_m: Float32[ndarray, "height width"] | None,
    shaping: TruthShaping,
    *,
    all_beams_m: Float32[ndarray, "height width"] | None = None,
) -> Float32[ndarray, "height width"]:
    """Compute the weight of each pixel in the loss: the product of the weights that apply.

    Args:
        truth_m: Dense truth before contours are widened; 0 = none.
        sparse_m: Measurements; 0 = none.
        filled_m: Classical completion of the measurements.
        shaping: The weights.
        all_beams_m: Measurements of all beams, where `sparse_m` has fewer: measured truth lies near
            these.
    """
    filled, thin = _fill_missing(truth_m), np.ones((_THIN_PX, _THIN_PX), np.uint8)
    farther = cv2.morphologyEx(filled, cv2.MORPH_CLOSE, thin)
    nearer = cv2.morphologyEx(filled, cv2.MORPH_OPEN, thin)
    is_thin = farther >= np.float32(_THIN_RATIO) * nearer
    is_measured = sparse_m > 0
    around = np.ones((_NEAR_PX, _NEAR_PX), np.uint8)
    is_reached = is_measured if all_beams_m is None else all_beams_m > 0
    is_away = cv2.dilate(is_reached.view(np.uint8), around) == 0
    weights = np.where(is_thin, np.float32(shaping.thin_weight), np.float32(1))
    weights = np.where(is_away, np.float32(shaping.away_weight) * weights, weights)
    if filled_m is None:
        return weights
    is_kept = is_measured & (filled_m == sparse_m)
    return np.where(is_kept, np.float32(shaping.kept_weight) * weights, weights)


def _fill_missing(truth_m: Float32[ndarray, "height width"]) -> Float32[ndarray, "height width"]:
    return np.where(truth_m > 0, truth_m, np.float32(_NO_TRUTH_M))


def _nearest_around(
    depth_m: Float32[ndarray, "height width"], reach_px: int
) -> Float32[ndarray, "height width"]:
    side = 2 * reach_px + 1
    return np.asarray(cv2.erode(depth_m, np.ones((side, side), np.uint8)))

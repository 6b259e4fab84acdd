"""Simulated truth made like measured truth: widened contours, and weights of pixels."""

import math
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from jaxtyping import Float32
from numpy import ndarray

_NO_TRUTH_M = 200.0  # stands for what has no truth, such as the sky
_CONTOUR_RATIO = 0.05  # nearer by this share, beyond the slope of the ground
_GROUND_SLOPE = 0.0016  # of inverse depth [1/m] in a row of KITTI's images; twice a level road's
_THIN_PX, _THIN_RATIO = 9, 1.05
_NEAR_PX = 7  # side of the square around a measurement that is not away from it


@dataclass(frozen=True, kw_only=True)
class TruthShaping:
    """How dense simulated truth is changed and weighed for training.

    Truth of real frames is accumulated from several sweeps: most of it lies near measurements, next
    to none on twigs or behind fences, and near surfaces come out a pixel or two too wide.
    """

    in_reach: bool = False
    """Whether truth above the highest measurement of the columns around is left out, of all beams,
    in training and for scores."""
    contours_px: int = 0
    """By how many pixels near surfaces are widened at contours."""
    contours_within_m: float = 20.0
    """Surfaces farther away than this are widened by one pixel at most."""
    thin_weight: float = 1.0
    """Weight of pixels on or beside what is thinner than nine pixels."""
    away_weight: float = 1.0
    """Weight of pixels more than three pixels from any measurement."""
    kept_weight: float = 1.0
    """Weight of measurements that the classical completion keeps, and predictors may put back."""

    def __post_init__(self) -> None:
        """Checks the numbers."""
        if self.contours_px < 0:
            raise ValueError(f"contours_px must be at least 0, got {self.contours_px}")
        for name in ("contours_within_m", "thin_weight", "away_weight", "kept_weight"):
            value = getattr(self, name)
            if not 0 <= value < math.inf:
                raise ValueError(f"{name} must be at least 0 and finite, got {value}")


AS_SIMULATED: Final = TruthShaping()
"""Truth as it comes, all pixels alike."""


def widen_near_surfaces(
    truth_m: Float32[ndarray, "height width"], shaping: TruthShaping
) -> Float32[ndarray, "height width"]:
    """Widen near surfaces at contours by up to `contours_px`; pixels without truth stay so.

    A contour is where the nearest truth around is nearer by 5 % beyond what the slope of the ground
    explains.
    """
    if not shaping.contours_px:
        return truth_m
    known = _known(truth_m)
    narrow, wide = (_nearest_around(known, px) for px in (1, shaping.contours_px))
    nearest = np.where(wide < shaping.contours_within_m, wide, narrow)
    slope = np.float32(_GROUND_SLOPE * (2 * shaping.contours_px + 1) / 2)
    is_contour = 1 / nearest - 1 / known > slope + np.float32(_CONTOUR_RATIO) / known
    return np.where((truth_m > 0) & is_contour, nearest, truth_m)


def pixel_weights(
    truth_m: Float32[ndarray, "height width"],
    sparse_m: Float32[ndarray, "height width"],
    filled_m: Float32[ndarray, "height width"] | None,
    shaping: TruthShaping,
) -> Float32[ndarray, "height width"]:
    """Weight of each pixel in the loss: the product of all that apply.

    Args:
        truth_m: Dense truth as it is, before contours are widened; 0 = none.
        sparse_m: Measurements; 0 = none.
        filled_m: Classical completion of them.
        shaping: The weights.
    """
    known, thin = _known(truth_m), np.ones((_THIN_PX, _THIN_PX), np.uint8)
    farther = cv2.morphologyEx(known, cv2.MORPH_CLOSE, thin)
    nearer = cv2.morphologyEx(known, cv2.MORPH_OPEN, thin)
    is_thin = farther >= np.float32(_THIN_RATIO) * nearer
    is_measured = sparse_m > 0
    around = np.ones((_NEAR_PX, _NEAR_PX), np.uint8)
    is_away = cv2.dilate(is_measured.view(np.uint8), around) == 0
    weights = np.where(is_thin, np.float32(shaping.thin_weight), np.float32(1))
    weights = np.where(is_away, np.float32(shaping.away_weight) * weights, weights)
    if filled_m is None:
        return weights
    is_kept = is_measured & (filled_m == sparse_m)
    return np.where(is_kept, np.float32(shaping.kept_weight) * weights, weights)


def _known(truth_m: Float32[ndarray, "height width"]) -> Float32[ndarray, "height width"]:
    return np.where(truth_m > 0, truth_m, np.float32(_NO_TRUTH_M))


def _nearest_around(
    depth_m: Float32[ndarray, "height width"], reach_px: int
) -> Float32[ndarray, "height width"]:
    side = 2 * reach_px + 1
    return np.asarray(cv2.erode(depth_m, np.ones((side, side), np.uint8)))

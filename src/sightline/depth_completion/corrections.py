"""Thresholds for a network's corrections of the classical completion."""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float32
from numpy import ndarray

from sightline.depth_completion.config import SignedThreshold

FIRST_ROWS_ABOVE, LAST_ROWS_ABOVE = 20, 30  # thresholds rise between these heights [rows]
COLUMNS_AROUND = 7  # columns to either side whose measurements count for a column
BESIDE_PX, AWAY_PX = 1.2, 2.5  # distances to a measurement: "beside" ends, "away" begins
_MIN_THRESHOLD = 1e-9  # avoids division by zero


class CorrectionThresholds(NamedTuple):
    """Threshold of corrections for each pixel: the logarithm of a factor."""

    nearer: Float32[ndarray, "height width"]
    """Threshold of corrections towards the camera."""
    farther: Float32[ndarray, "height width"]
    """Threshold of corrections away from the camera."""


def correction_thresholds(
    is_measured: Bool[ndarray, "height width"],
    *,
    default: float,
    above: SignedThreshold,
    beside: SignedThreshold,
) -> CorrectionThresholds:
    """Compute the threshold of corrections for each pixel.

    In two places only large corrections are useful. Far above the highest measurement, completion
    and network both guess: most corrections lower the mean error but raise the median. Beside a
    measurement the completion is seldom wrong, and corrections away from the camera gain almost
    nothing. The rows are for a camera like KITTI's, with a focal length of 721 px.

    Args:
        is_measured: Mask of the measured pixels.
        default: Threshold where neither of the others applies.
        above: Threshold from 30 rows above the highest measurement of the columns around a pixel;
            it rises linearly between 20 and 30 rows.
        beside: Threshold up to 1.2 px from a measurement; it changes linearly until 2.5 px.
    """
    height = is_measured.shape[0]
    top = np.where(is_measured.any(axis=0), is_measured.argmax(axis=0), height)
    around = np.ones((1, 2 * COLUMNS_AROUND + 1), np.uint8)
    top = cv2.erode(top[None].astype(np.float32), around)[0]  # the border adds no lower value
    rows_above = top - np.arange(height, dtype=np.float32)[:, None]
    is_above = ((rows_above - FIRST_ROWS_ABOVE) / (LAST_ROWS_ABOVE - FIRST_ROWS_ABOVE)).clip(0, 1)
    is_beside = _is_beside(is_measured)  # 0 wherever is_above is positive
    nearer, farther = (
        (default + (far - default) * is_above + (close - default) * is_beside).astype(np.float32)
        for far, close in ((above.nearer, beside.nearer), (above.farther, beside.farther))
    )
    return CorrectionThresholds(nearer, farther)


def _is_beside(is_measured: Bool[ndarray, "height width"]) -> Float32[ndarray, "height width"]:
    """Map that is 1 beside a measurement, 0 away from all, and linear in between."""
    measured = is_measured.astype(np.uint8)
    share = np.zeros(measured.shape, np.float32)
    away_px = np.hypot(*np.mgrid[-2:3, -2:3])  # includes all pixels less than AWAY_PX away
    for reach_px in np.unique(away_px[away_px < AWAY_PX])[::-1]:  # the nearest last
        within = cv2.dilate(measured, (away_px <= reach_px).astype(np.uint8))
        share[within > 0] = min((AWAY_PX - reach_px) / (AWAY_PX - BESIDE_PX), 1)
    return share


def drop_small_corrections(
    depth_m: Float32[ndarray, "height width"],
    filled_m: Float32[ndarray, "height width"],
    thresholds: CorrectionThresholds,
) -> Float32[ndarray, "height width"]:
    """Undo a network's corrections up to the threshold; keep those from twice the threshold on.

    In between they grow linearly: a step would magnify rounding differences between engines.
    Non-finite values stay non-finite.

    Args:
        depth_m: Depth from the network [m].
        filled_m: Completion that the network corrected [m].
        thresholds: Thresholds for both directions.
    """
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        correction = np.log(depth_m / filled_m)
        threshold = np.where(correction < 0, thresholds.nearer, thresholds.farther)
        share = (np.abs(correction) / np.maximum(threshold, _MIN_THRESHOLD) - 1).clip(0, 1)
        corrected: Float32[ndarray, "height width"] = filled_m * np.exp(share * correction)
    return np.where(np.isfinite(correction), corrected, depth_m).astype(np.float32)

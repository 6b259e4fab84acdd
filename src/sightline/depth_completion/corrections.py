"""Which of a network's corrections of the classical completion count."""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float32
from numpy import ndarray

from sightline.depth_completion.config import ByDirection

FIRST_ROWS_ABOVE, LAST_ROWS_ABOVE = 20, 30  # above what is measured, thresholds rise between them
COLUMNS_AROUND = 7  # columns to either side whose measurements count as a column's own
BESIDE_PX, AWAY_PX = 1.2, 2.5  # from a measurement: beside it up to the first
_LEAST_THRESHOLD = 1e-9  # to divide by


class LeastCorrections(NamedTuple):
    """How large a correction must be to count, pixel by pixel: the logarithm of a factor."""

    nearer: Float32[ndarray, "height width"]
    """Of corrections that bring a pixel nearer to the camera."""
    farther: Float32[ndarray, "height width"]
    """Of corrections that take it farther away."""


def least_corrections(
    is_measured: Bool[ndarray, "height width"],
    *,
    least: float,
    above: ByDirection,
    beside: ByDirection,
) -> LeastCorrections:
    """How large a network's corrections must be to count.

    Far above the highest measurement of its columns, where a completion and a network guess alike,
    most corrections lower the mean error and raise the median; beside a measurement the completion
    is seldom wrong, and what takes a pixel farther away there is worth next to nothing: in both
    places only large ones shall count. The rows are of a camera like KITTI's, with a focal length
    of 721 px.

    Args:
        is_measured: Where there are measurements.
        least: Where none of the others holds.
        above: From 30 rows above the highest measurement of the columns around a pixel on; between
            20 and 30 rows the threshold rises evenly.
        beside: Up to 1.2 px from a measurement; the threshold changes evenly until 2.5 px.
    """
    height = is_measured.shape[0]
    top = np.where(is_measured.any(axis=0), is_measured.argmax(axis=0), height)
    around = np.ones((1, 2 * COLUMNS_AROUND + 1), np.uint8)
    top = cv2.erode(top[None].astype(np.float32), around)[0]  # beyond the border nothing is lower
    rows_above = top - np.arange(height, dtype=np.float32)[:, None]
    is_above = ((rows_above - FIRST_ROWS_ABOVE) / (LAST_ROWS_ABOVE - FIRST_ROWS_ABOVE)).clip(0, 1)
    is_beside = _is_beside(is_measured)  # never where it is above
    nearer, farther = (
        (least + (far - least) * is_above + (close - least) * is_beside).astype(np.float32)
        for far, close in ((above.nearer, beside.nearer), (above.farther, beside.farther))
    )
    return LeastCorrections(nearer, farther)


def _is_beside(is_measured: Bool[ndarray, "height width"]) -> Float32[ndarray, "height width"]:
    """1 beside a measurement, 0 away from all, shares in between."""
    measured = is_measured.astype(np.uint8)
    share = np.zeros(measured.shape, np.float32)
    away_px = np.hypot(*np.mgrid[-2:3, -2:3])  # holds all that is less than AWAY_PX away
    for reach_px in np.unique(away_px[away_px < AWAY_PX])[::-1]:  # the nearest last
        within = cv2.dilate(measured, (away_px <= reach_px).astype(np.uint8))
        share[within > 0] = min((AWAY_PX - reach_px) / (AWAY_PX - BESIDE_PX), 1)
    return share


def drop_small_corrections(
    depth_m: Float32[ndarray, "height width"],
    filled_m: Float32[ndarray, "height width"],
    least: LeastCorrections,
) -> Float32[ndarray, "height width"]:
    """A network's depth with corrections up to the threshold undone, and full ones from twice it.

    In between they grow evenly: a step would magnify the last digit of an engine. What is not
    finite stays so.

    Args:
        depth_m: The network's [m].
        filled_m: The completion that it corrected [m].
        least: The thresholds.
    """
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        correction = np.log(depth_m / filled_m)
        threshold = np.where(correction < 0, least.nearer, least.farther)
        share = (np.abs(correction) / np.maximum(threshold, _LEAST_THRESHOLD) - 1).clip(0, 1)
        counted: Float32[ndarray, "height width"] = filled_m * np.exp(share * correction)
    return np.where(np.isfinite(correction), counted, depth_m).astype(np.float32)

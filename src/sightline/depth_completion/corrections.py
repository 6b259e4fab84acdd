"""Which of a network's corrections of the classical completion count."""

import cv2
import numpy as np
from jaxtyping import Bool, Float32
from numpy import ndarray

_FIRST_ROWS, _LAST_ROWS = 20, 50  # above what is measured, the threshold rises between them
_NEIGHBOURS = 7  # columns to either side whose measurements count as a column's own
_LEAST_THRESHOLD = 1e-9  # to divide by


def least_corrections(
    is_measured: Bool[ndarray, "height width"], *, least: float, least_above: float
) -> Float32[ndarray, "height width"]:
    """How large a correction must be to count, pixel by pixel: the logarithm of a factor.

    Far above the highest measurement of its columns, where a completion and a network guess alike,
    most corrections lower the mean error and raise the median: only large ones shall count. The
    rows are of a camera like KITTI's, with a focal length of 721 px.

    Args:
        is_measured: Where there are measurements.
        least: Up to 20 rows above the highest one of the columns around a pixel, and below it.
        least_above: From 50 rows above it on; the threshold rises evenly in between.
    """
    height = is_measured.shape[0]
    top = np.where(is_measured.any(axis=0), is_measured.argmax(axis=0), height)
    around = np.ones((1, 2 * _NEIGHBOURS + 1), np.uint8)
    top = cv2.erode(top[None].astype(np.float32), around)[0]  # beyond the border nothing is lower
    above = top - np.arange(height, dtype=np.float32)[:, None]
    share = ((above - _FIRST_ROWS) / (_LAST_ROWS - _FIRST_ROWS)).clip(0, 1)
    threshold: Float32[ndarray, "height width"] = least + (least_above - least) * share
    return threshold.astype(np.float32)


def drop_small_corrections(
    depth_m: Float32[ndarray, "height width"],
    filled_m: Float32[ndarray, "height width"],
    least: Float32[ndarray, "height width"],
) -> Float32[ndarray, "height width"]:
    """A network's depth with corrections up to the threshold undone, and full ones from twice it.

    In between they grow evenly: a step would magnify the last digit of an engine. What is not
    finite stays so.

    Args:
        depth_m: The network's [m].
        filled_m: The completion that it corrected [m].
        least: The thresholds, logarithms of factors.
    """
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        correction = np.log(depth_m / filled_m)
        share = (np.abs(correction) / np.maximum(least, _LEAST_THRESHOLD) - 1).clip(0, 1)
        counted: Float32[ndarray, "height width"] = filled_m * np.exp(share * correction)
    return np.where(np.isfinite(correction), counted, depth_m).astype(np.float32)

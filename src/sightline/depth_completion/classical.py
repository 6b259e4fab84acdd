"""Depth completion by image morphology."""

from dataclasses import dataclass
from typing import Literal, get_args

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float32

from sightline.depth_completion.sparse_map import check_sparse_depth
from sightline.structures.predictions import DepthMap

Blur = Literal["gaussian", "bilateral"]
"""Filter of the last smoothing step."""

_DIAMOND = np.array(
    [
        [0, 0, 1, 0, 0],
        [0, 1, 1, 1, 0],
        [1, 1, 1, 1, 1],
        [0, 1, 1, 1, 0],
        [0, 0, 1, 0, 0],
    ],
    np.uint8,
)
_CLOSING = np.ones((5, 5), np.uint8)
_SMALL_HOLE = np.ones((7, 7), np.uint8)
_LARGE_HOLE = np.ones((31, 31), np.uint8)
_BLUR_SIZE = 5
_BILATERAL_SIGMA_M = 1.5  # in depth
_BILATERAL_SIGMA_PX = 2.0
_EMPTY_BELOW_M = 0.1


@dataclass(frozen=True, kw_only=True, slots=True)
class ClassicalConfig:
    """Morphological completion. Its kernels are made for 64 beams and KITTI's image size."""

    blur: Blur = "gaussian"
    """Filter of the last smoothing step: gaussian has the lower error, bilateral keeps edges."""
    extrapolate: bool = True
    """Whether columns are extended to the top of the image and large holes filled."""
    max_depth_m: float = 100.0
    """Depth from which depths are subtracted for inversion; farther measurements are left out."""

    def __post_init__(self) -> None:
        """Check the blur and the range."""
        if self.blur not in get_args(Blur):
            raise ValueError(f"blur must be gaussian or bilateral, got {self.blur!r}")
        if not 2 * _EMPTY_BELOW_M < self.max_depth_m < np.inf:
            raise ValueError(
                f"max_depth_m must be above {2 * _EMPTY_BELOW_M} and finite, got {self.max_depth_m}"
            )


def classical_depth(
    sparse_depth_m: Float32[np.ndarray, "height width"],
    config: ClassicalConfig = ClassicalConfig(),
) -> DepthMap:
    """Morphology on inverted depth: Ku, Harakeh, Waslander 2018 (arXiv:1802.00036), section III.

    Depth d is inverted to `max_depth_m` - d, so that near surfaces win a dilation. The steps are:
    diamond dilation, closing, small holes, extension to the top, large holes, median, blur, and
    inversion back. Measured pixels do not keep their values. Pixels filled by the first three
    steps are valid; the extension and the large holes are guesses; other pixels have no value.
    Around empty pixels the Gaussian mixes in the farthest depth, as the authors' program does: one
    reason why this method fails with fewer than 32 beams.

    Departure: measurements beyond `max_depth_m`, or within 0.1 m of either end, are left out at
    the start; inversion would make them empty or negative.

    Raises:
        ValueError: `sparse_depth_m` contains invalid depths.
    """
    check_sparse_depth(sparse_depth_m)
    is_kept = (sparse_depth_m > _EMPTY_BELOW_M) & (
        sparse_depth_m < config.max_depth_m - _EMPTY_BELOW_M
    )
    inverted = np.where(is_kept, np.float32(config.max_depth_m) - sparse_depth_m, np.float32(0))
    inverted = cv2.dilate(inverted, _DIAMOND)
    inverted = cv2.morphologyEx(inverted, cv2.MORPH_CLOSE, _CLOSING)
    inverted = _fill_holes(inverted, _SMALL_HOLE)
    is_reached = _is_filled(inverted)
    if config.extrapolate:
        inverted = _extend_to_top(inverted)
        inverted = _fill_holes(inverted, _LARGE_HOLE)
    inverted = cv2.medianBlur(inverted, _BLUR_SIZE)
    inverted = _blurred(inverted, config)
    has_value = _is_filled(inverted)
    depth_m = np.where(has_value, np.float32(config.max_depth_m) - inverted, np.float32(0))
    return DepthMap(
        depth_m=torch.from_numpy(depth_m), valid=torch.from_numpy(is_reached & has_value)
    )


def _is_filled(inverted: Float32[np.ndarray, "height width"]) -> Bool[np.ndarray, "height width"]:
    return inverted > _EMPTY_BELOW_M


def _fill_holes(
    inverted: Float32[np.ndarray, "height width"], kernel: np.ndarray
) -> Float32[np.ndarray, "height width"]:
    """Fill empty pixels with the nearest surface's depth under the kernel."""
    return np.where(_is_filled(inverted), inverted, cv2.dilate(inverted, kernel))


def _extend_to_top(
    inverted: Float32[np.ndarray, "height width"],
) -> Float32[np.ndarray, "height width"]:
    """Extend the topmost depth of each column to the top of the image."""
    is_filled = _is_filled(inverted)
    top_rows = is_filled.argmax(axis=0)
    top_values = np.take_along_axis(inverted, top_rows[None], axis=0)
    rows = np.arange(len(inverted))[:, None]
    return np.where(rows < top_rows, top_values, inverted)


def _blurred(
    inverted: Float32[np.ndarray, "height width"], config: ClassicalConfig
) -> Float32[np.ndarray, "height width"]:
    if config.blur == "bilateral":
        smooth = cv2.bilateralFilter(inverted, _BLUR_SIZE, _BILATERAL_SIGMA_M, _BILATERAL_SIGMA_PX)
        return np.asarray(smooth)
    smooth = cv2.GaussianBlur(inverted, (_BLUR_SIZE, _BLUR_SIZE), 0)
    return np.where(_is_filled(inverted), smooth, inverted)

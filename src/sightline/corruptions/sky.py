"""Which pixels of an image show the sky, with a LiDAR's measurements against what only looks so."""

import cv2
import numpy as np
from jaxtyping import Bool, Int64, UInt8

_BLUER = 1.15  # blue by red of a blue sky, at least
_BLUE_LEVEL = 110  # of one, at least; what is darker lies in the shade
_WHITE_LEVEL = 225  # of an overexposed one
_CLOUD_SHARE = 0.6  # of the level of the image's brightest tenth: clouds, at least
_RINGS_PX = 9  # rings are less apart, in KITTI's image
_WINDOW_PX = 15


def sky_mask(
    planes: UInt8[np.ndarray, "3 height width"],
    is_known: Bool[np.ndarray, "height width"],
    is_silent: Bool[np.ndarray, "height width"],
) -> Bool[np.ndarray, "height width"]:
    """What is blue, or white, or where the LiDAR was silent as bright as a cloud; but no wall.

    A wall of such a colour is told by the pixels below: without an edge they lead down among
    measured ones, by more than rings are apart. What most of the surroundings say counts, as some
    measurements lie beside the edge that they are of.

    Args:
        planes: The part of an image that is above the horizon, RGB.
        is_known: Which of its pixels are measured.
        is_silent: Where the LiDAR has had no echo, though it may have looked there.
    """
    if not planes.size:
        return is_known
    red, green, blue = planes.astype(np.int16)
    is_blue = (blue > _BLUER * red) & (blue >= green) & (blue >= _BLUE_LEVEL)
    level = planes.min(axis=0)
    cloud_level = min(_CLOUD_SHARE * float(np.percentile(level[::4, ::4], 90)), _WHITE_LEVEL)
    is_alike = is_blue | (level >= np.where(is_silent, cloud_level, _WHITE_LEVEL))
    upright = np.ones((_RINGS_PX, 1), dtype=np.uint8)  # closes small gaps in an upright run
    in_run = cv2.morphologyEx(is_alike.astype(np.uint8), cv2.MORPH_CLOSE, upright) > 0
    is_beside = cv2.dilate(is_known.astype(np.uint8), np.ones((1, 3), dtype=np.uint8)) > 0
    is_wall = is_alike & (_next_row(~in_run) >= _next_row(is_beside) + _RINGS_PX)
    walls, all_alike = (
        cv2.blur(each.astype(np.float32), (_WINDOW_PX, _WINDOW_PX)) for each in (is_wall, is_alike)
    )
    is_sky: Bool[np.ndarray, "height width"] = is_alike & (walls <= all_alike / 2)
    return is_sky


def _next_row(is_there: Bool[np.ndarray, "height width"]) -> Int64[np.ndarray, "height width"]:
    """Of each pixel the first row, from its own downwards, that is there; else the height."""
    height, _ = is_there.shape
    rows = np.where(is_there, np.arange(height)[:, None], height)
    next_row: Int64[np.ndarray, "height width"] = np.minimum.accumulate(rows[::-1])[::-1]
    return next_row

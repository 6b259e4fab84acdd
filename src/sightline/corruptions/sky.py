"""Sky segmentation of an image, with a LiDAR's measurements to reject surfaces of sky colours."""

import cv2
import numpy as np
from jaxtyping import Bool, Int64, UInt8

_BLUER = 1.15  # minimum ratio of blue to red in a blue sky
_BLUE_LEVEL = 110  # its minimum level; darker pixels lie in the shade
_WHITE_LEVEL = 225  # minimum level of an overexposed sky
_CLOUD_SHARE = 0.6  # minimum level of clouds, as a share of the image's brightest tenth
_RINGS_PX = 9  # more than the spacing of rings in KITTI's image
_WINDOW_PX = 15


def sky_mask(
    planes: UInt8[np.ndarray, "3 height width"],
    is_known: Bool[np.ndarray, "height width"],
    is_silent: Bool[np.ndarray, "height width"],
) -> Bool[np.ndarray, "height width"]:
    """Mark pixels that are blue, white, or without echo and as bright as a cloud, except walls.

    A wall of such a colour is detected from the pixels below: they lead down without an edge to
    measured pixels, over more than the spacing of rings. The majority of the surroundings decides,
    as some measurements lie beside their edge.

    Args:
        planes: Part of an image above the horizon, RGB.
        is_known: Measured pixels.
        is_silent: Pixels without an echo that the LiDAR may have covered.
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
    """Find for each pixel the first marked row from its own downwards; otherwise the height."""
    height, _ = is_there.shape
    rows = np.where(is_there, np.arange(height)[:, None], height)
    next_row: Int64[np.ndarray, "height width"] = np.minimum.accumulate(rows[::-1])[::-1]
    return next_row

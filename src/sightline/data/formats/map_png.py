"""Readers and writers of maps as PNGs: depth and instances with 16 bits, masks with 8."""

from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Int32
from numpy.typing import ArrayLike

from sightline.data.formats.image_file import read_png16, read_rgb
from sightline.files.atomic import atomic_write_bytes
from sightline.files.problem import FileError
from sightline.geometry.plain_arrays import shaped_array, without_masked
from sightline.geometry.wrong_types import named_arguments

STEPS_PER_METRE = 256
MAX_DEPTH_M = 65535 / STEPS_PER_METRE
"""Largest depth in 16 bits."""
MIN_HIGHEST_PX, MIN_HIGHEST_SHARE = 100, 0.01
"""Least number and share of pixels with the largest depth that probably mean no value."""
NO_VALUE_REMEDY = "write 0 for no value"
_YES = 255
_MIN_TWO_LEVELS = 0.5  # share of a mask with its two most frequent levels; other ones are edges


@named_arguments
def read_depth_png(path: Path | str) -> Float32[np.ndarray, "height width"]:
    """Read a depth map in metres; 0 = no value. Exact: every step of 1/256 m is a float32.

    Raises:
        FileError: The file is no complete PNG of one channel with 16 bits.
    """
    steps = read_png16(
        path,
        expected="a depth map: PNG, 1 channel, 16 bits (metres times 256)",
        remedy="convert it without a loss of depth or name the depth folder",
    )
    return steps.astype(np.float32) / np.float32(STEPS_PER_METRE)


@named_arguments
def write_depth_png(path: Path | str, depth_m: ArrayLike) -> None:
    """Write a depth map [m], 0 = no value, rounded half up to steps of 1/256 m.

    A depth above 0 that would round to 0 becomes the smallest step, as in KITTI's development kit.
    The file is written atomically.

    Args:
        path: The PNG.
        depth_m: Numbers of height, width, an array or a tensor; masked ones have no value.

    Raises:
        ValueError: The map has another shape or type, a depth is negative, not finite or beyond
            `MAX_DEPTH_M`, or there is no pixel; nothing is clipped silently.
    """
    expected = "numbers of height, width; give metres, one map at a time"
    depth_m = shaped_array(
        f"the depth map for {path}", without_masked(depth_m, 0.0), (None, None), "fiu", expected
    )
    if depth_m.size == 0:
        raise ValueError(f"{path} cannot be written: a depth map needs at least one pixel")
    with np.errstate(over="ignore"):  # an absurd depth becomes infinite, which is refused below
        steps = np.floor(depth_m.astype(np.float64) * STEPS_PER_METRE + 0.5)
    # In this form NaN is refused, too: its comparisons are false.
    writable = (depth_m >= 0) & (steps <= np.iinfo(np.uint16).max)
    if not writable.all():
        row, column = np.argwhere(~writable)[0]
        raise ValueError(
            f"{path} cannot be written: {np.count_nonzero(~writable)} depths lie outside 0 to "
            f"{MAX_DEPTH_M:.3f} m, the first is {depth_m[row, column]} m at row {row}, column "
            f"{column}; use 0 for no value and limit the rest"
        )
    steps = np.where((depth_m > 0) & (steps == 0), 1, steps).astype(np.uint16)
    # OpenCV's own choice makes smooth maps half as large again; higher levels take far longer.
    _, encoded = cv2.imencode(".png", steps, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    atomic_write_bytes(path, encoded.tobytes())


@named_arguments
def read_instance_png(path: Path | str) -> Int32[np.ndarray, "height width"]:
    """Read an instance map: 1 + the row of the pixel's object in the frame's label file; 0 = none.

    Raises:
        FileError: The file is no complete PNG of one channel with 16 bits.
    """
    owners = read_png16(
        path,
        expected="a map of objects: PNG, 1 channel, 16 bits",
        remedy="name a file of the folder instance",
    )
    return owners.astype(np.int32)


@named_arguments
def write_instance_png(path: Path | str, instances: ArrayLike) -> None:
    """Write an instance map for `read_instance_png` atomically.

    Raises:
        ValueError: The map is not of whole numbers of height, width, a number is negative or above
            65535, or there is no pixel.
    """
    expected = "whole numbers of height, width; convert it"
    instances = shaped_array(f"the map for {path}", instances, (None, None), "iu", expected)
    if instances.size == 0 or instances.min() < 0 or instances.max() > np.iinfo(np.uint16).max:
        raise ValueError(
            f"{path} cannot be written: a map of objects needs pixels, each 0 to 65535; number the "
            "objects from 1"
        )
    _, encoded = cv2.imencode(".png", instances.astype(np.uint16))
    atomic_write_bytes(path, encoded.tobytes())


@named_arguments
def read_mask_png(path: Path | str) -> Bool[np.ndarray, "height width"]:
    """Read a mask of `write_mask_png`: True for pixels lighter than middle grey.

    Raises:
        FileError: The file is no complete picture, or probably none of a mask: its two most
            frequent levels fill less than half of it, or all are below middle grey and not black.
    """
    levels = read_rgb(path).max(axis=-1)
    counts = np.bincount(levels.ravel())
    share = np.sort(counts)[-2:].sum() / levels.size
    if share < _MIN_TWO_LEVELS:
        raise FileError(
            path,
            f"is a picture of {np.count_nonzero(counts)} levels, the two most frequent of them in "
            f"{100 * share:.0f} % of its pixels, expected a mask: white for True, black for False",
            "name the file of a mask",
        )
    if 1 < len(counts) <= _YES // 2 + 1:  # all of them below middle grey
        raise FileError(
            path,
            f"has no level above {len(counts) - 1}, expected a mask: {_YES} for True, 0 for False",
            "write it by write_mask_png",
        )
    mask: Bool[np.ndarray, "height width"] = levels > _YES // 2
    return mask


@named_arguments
def write_mask_png(path: Path | str, mask: ArrayLike) -> None:
    """Write a mask with 8 bits, visible in any viewer: white for True, black for False; atomic.

    Raises:
        ValueError: The mask is not of bool and height, width, or there is no pixel.
    """
    expected = "bool of height, width; give mask > 0, say"
    mask = shaped_array(f"the mask for {path}", mask, (None, None), "b", expected)
    if mask.size == 0:
        raise ValueError(f"{path} cannot be written: a mask needs at least one pixel")
    _, encoded = cv2.imencode(".png", mask.astype(np.uint8) * _YES)
    atomic_write_bytes(path, encoded.tobytes())

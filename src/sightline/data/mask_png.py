"""Reader and writer of masks as PNGs with 8 bits, visible in any viewer."""

from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool

from sightline.data.image_file import read_rgb
from sightline.files.atomic import atomic_write_bytes

_YES = 255


def read_mask_png(path: Path | str) -> Bool[np.ndarray, "height width"]:
    """Read a mask of `write_mask_png`: True for pixels lighter than middle grey.

    Raises:
        FileError: The file is no complete picture.
    """
    mask: Bool[np.ndarray, "height width"] = read_rgb(path)[..., 0] > _YES // 2
    return mask


def write_mask_png(path: Path | str, mask: Bool[np.ndarray, "height width"]) -> None:
    """Write a mask atomically: white for True, black for False.

    Raises:
        ValueError: There is no pixel.
    """
    if mask.size == 0:
        raise ValueError(f"{path} cannot be written: a mask needs at least one pixel")
    _, encoded = cv2.imencode(".png", mask.astype(np.uint8) * _YES)
    atomic_write_bytes(path, encoded.tobytes())

"""Reader and writer of instance maps as PNGs with 16 bits."""

from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Int32

from sightline.data.image_file import read_png16
from sightline.files.atomic import atomic_write_bytes


def read_instance_png(path: Path | str) -> Int32[np.ndarray, "height width"]:
    """Reads an instance map: 1 + the row of the pixel's object in the frame's label file; 0 = none.

    Raises:
        FileError: The file is no complete PNG of one channel with 16 bits.
    """
    owners = read_png16(
        path,
        expected="a map of objects: PNG, 1 channel, 16 bits",
        remedy="name a file of the folder instance",
    )
    return owners.astype(np.int32)


def write_instance_png(path: Path | str, instances: Int32[np.ndarray, "height width"]) -> None:
    """Writes an instance map for `read_instance_png` atomically.

    Raises:
        ValueError: A number is negative or above 65535, or there is no pixel.
    """
    if instances.size == 0 or instances.min() < 0 or instances.max() > np.iinfo(np.uint16).max:
        raise ValueError(
            f"{path} cannot be written: a map of objects needs pixels, each 0 to 65535; number the "
            "objects from 1"
        )
    _, encoded = cv2.imencode(".png", instances.astype(np.uint16))
    atomic_write_bytes(path, encoded.tobytes())

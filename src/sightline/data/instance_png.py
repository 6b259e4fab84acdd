"""Maps of which object each pixel shows, as PNGs with 16 bits."""

from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Int32

from sightline.data.atomic import atomic_write_bytes
from sightline.data.image_file import decode_pixels
from sightline.data.image_header import parse_image_header


def read_instance_png(path: Path | str) -> Int32[np.ndarray, "height width"]:
    """Reads for each pixel 1 + the row of its object in the frame's label file; 0 = none.

    Raises:
        ValueError: The file is no whole PNG of one channel with 16 bits.
    """
    content = Path(path).read_bytes()
    header = parse_image_header(content, path)
    if (header.file_format, header.bits_per_channel, header.channels) != ("png", 16, 1):
        raise ValueError(
            f"{path} is a {header.file_format.upper()} of {header.channels} channels with "
            f"{header.bits_per_channel} bits, expected a map of objects: PNG, 1 channel, 16 bits; "
            "name a file of the folder instance"
        )
    return decode_pixels(content, header, cv2.IMREAD_ANYDEPTH, path).astype(np.int32)


def write_instance_png(path: Path | str, instances: Int32[np.ndarray, "height width"]) -> None:
    """Writes what `read_instance_png` reads, aside first and then renamed.

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

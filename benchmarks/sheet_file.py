"""Contact sheets as JPEG files of a bounded size."""

from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

from sightline.files.atomic import atomic_write_bytes

_QUALITIES = range(90, 10, -5)


def write_sheet(path: Path, sheet: UInt8[np.ndarray, "height width 3"], max_bytes: int) -> None:
    """Writes an RGB sheet at the best quality that fits.

    Raises:
        ValueError: None does.
    """
    for quality in _QUALITIES:
        _, encoded = cv2.imencode(".jpg", sheet[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
        if encoded.nbytes <= max_bytes:
            atomic_write_bytes(path, encoded.tobytes())
            return
    raise ValueError(f"the sheet takes more than {max_bytes:,} bytes; draw fewer frames")

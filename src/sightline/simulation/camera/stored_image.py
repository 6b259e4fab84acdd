"""Changes of an image between the sensor and the file."""

import cv2
import numpy as np
from jaxtyping import UInt8

Image = UInt8[np.ndarray, "height width 3"]


def stored_image(
    image: Image, white_balance: tuple[float, float, float], jpeg_quality: int
) -> Image:
    """Apply factors on red, green and blue, and the loss of a JPEG; a quality of 100 loses none.

    The factors fade towards full values, so that what is overexposed stays white.
    """
    if white_balance != (1.0, 1.0, 1.0):
        level = np.arange(256)[:, None]
        factors = np.array(white_balance)
        levels = level * (factors + (1 - factors) * (level / 255) ** 4)
        table = levels.clip(0, 255).round().astype(np.uint8)
        image = np.stack([table[:, band][image[..., band]] for band in range(3)], axis=-1)
    if jpeg_quality >= 100:
        return image
    _, packed = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality])
    unpacked = cv2.imdecode(packed, cv2.IMREAD_COLOR)
    assert unpacked is not None, "OpenCV has just written it"
    return np.ascontiguousarray(unpacked[..., ::-1]).astype(np.uint8, copy=False)

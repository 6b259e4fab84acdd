"""Strength of an image's edges in one direction, relative to the surroundings."""

from typing import Literal

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

_ALONG_PX, _ACROSS_PX = 81, 41  # neighbourhood of an edge: along the gradient and across


def edge_strength(
    image: UInt8[np.ndarray, "height width 3"], gradient: Literal["horizontal", "vertical"]
) -> Float32[np.ndarray, "height width"]:
    """Compute the root of the gradient over its local mean, so that faint edges count too."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32)
    is_horizontal = gradient == "horizontal"
    order = (1, 0) if is_horizontal else (0, 1)
    slope = cv2.Sobel(cv2.GaussianBlur(grey, (0, 0), 1), cv2.CV_32F, *order)
    strength = np.sqrt(np.abs(slope))
    around_px = (_ALONG_PX, _ACROSS_PX) if is_horizontal else (_ACROSS_PX, _ALONG_PX)
    even: Float32[np.ndarray, "height width"]
    even = strength / (cv2.blur(strength, around_px) + 1)
    return even

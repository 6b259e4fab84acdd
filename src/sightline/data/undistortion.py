"""Pictures as a lens without distortion would have taken them, by OpenCV's models."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Final, Literal, SupportsFloat

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

LensModel = Literal["plumb_bob", "rational_polynomial", "equidistant"]
"""As ROS calls them: OpenCV's model of 5 or of 8 coefficients, and its fisheye's of 4."""

COEFFICIENTS: Final[dict[LensModel, tuple[int, ...]]] = {
    "plumb_bob": (4, 5),
    "rational_polynomial": (8, 12, 14),
    "equidistant": (4,),
}
"""How many numbers each model takes."""

_Row = tuple[float, ...]


def undistort(
    image: np.ndarray,
    camera_matrix: Sequence[Sequence[SupportsFloat]] | np.ndarray,
    distortion: Sequence[SupportsFloat] | np.ndarray,
    *,
    model: LensModel = "plumb_bob",
) -> UInt8[np.ndarray, "height width 3"]:
    """A picture straightened, so that it follows `camera_matrix` alone; black where nothing was.

    Examples:
        >>> import numpy as np, sightline
        >>> image = np.zeros((60, 80, 3), np.uint8)
        >>> image[:, 5] = 255  # near the left edge a barrel-shaped lens bends a line
        >>> camera_matrix = [[70, 0, 39.5], [0, 70, 29.5], [0, 0, 1]]
        >>> straight = sightline.undistort(image, camera_matrix, [-0.2, 0.05, 0, 0, 0])
        >>> straight.shape, bool(straight[30, :5].any())  # it has moved outwards
        ((60, 80, 3), True)

    Args:
        image: Height, width, 3; RGB of 8 bits, as the camera gave it.
        camera_matrix: 3x3 [px], of the distorted picture and of the result.
        distortion: k1, k2, p1, p2 (, k3 (, k4, k5, k6 ..)), or k1 to k4 of a fisheye lens.
        model: Which of them.

    Raises:
        ValueError: The image or the matrix is something else, the model takes another number of
            coefficients, or they are not finite.
    """
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
        raise ValueError(
            f"the image is {image.dtype} of shape {image.shape}, expected uint8 of height, width, "
            "3; convert it to RGB of 8 bits"
        )
    camera = np.asarray(camera_matrix, dtype=np.float64)
    if camera.shape not in ((3, 3), (3, 4)) or not np.isfinite(camera).all():
        raise ValueError(
            f"camera_matrix is of shape {camera.shape}, expected 3x3 finite numbers; give [[fx, 0, "
            "cx], [0, fy, cy], [0, 0, 1]] in pixels"
        )
    coefficients = tuple(map(float, np.array(distortion, dtype=np.float64).ravel()))
    check_lens(model, coefficients)
    rows = tuple(map(tuple, camera[:, :3].tolist()))
    columns_px, rows_px = _maps(rows, coefficients, model, (image.shape[0], image.shape[1]))
    straight = cv2.remap(image, columns_px, rows_px, cv2.INTER_LINEAR)
    return straight.astype(np.uint8, copy=False)


def check_lens(model: LensModel, coefficients: Sequence[float]) -> None:
    """Refuses coefficients that the model does not take.

    Raises:
        ValueError: There is no such model, or it takes another number, or they are not finite.
    """
    if model not in COEFFICIENTS:
        raise ValueError(
            f"there is no lens model {model}; give one of {', '.join(COEFFICIENTS)}, or straighten "
            "the pictures elsewhere"
        )
    if len(coefficients) not in COEFFICIENTS[model] or not np.isfinite(coefficients).all():
        counts = " or ".join(map(str, COEFFICIENTS[model]))
        raise ValueError(
            f"the lens has {len(coefficients)} coefficients of distortion, expected {counts} "
            f"finite numbers of the model {model}"
        )


@lru_cache(maxsize=8)
def _maps(
    camera_matrix: tuple[_Row, ...], coefficients: _Row, model: LensModel, size: tuple[int, int]
) -> tuple[Float32[np.ndarray, "height width"], Float32[np.ndarray, "height width"]]:
    """Where each pixel of the result lies in the distorted picture: column and row [px]."""
    camera, lens = np.array(camera_matrix), np.array(coefficients)
    make = (
        cv2.fisheye.initUndistortRectifyMap
        if model == "equidistant"
        else cv2.initUndistortRectifyMap
    )
    columns_px, rows_px = make(camera, lens, np.eye(3), camera, size[::-1], cv2.CV_32FC1)
    return np.asarray(columns_px, np.float32), np.asarray(rows_px, np.float32)

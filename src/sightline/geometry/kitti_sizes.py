"""Sizes of KITTI's images by their camera matrix, for images cropped or resized without it.

Without PyTorch, for checks that start at once.
"""

from collections.abc import Callable
from typing import Final

import numpy as np
from jaxtyping import Float64, UInt8

_SIZES: Final = {
    (721.5377, 609.5593, 172.854): (375, 1242),
    (707.0493, 604.0814, 180.5066): (370, 1224),
    (718.3351, 600.3891, 181.5122): (374, 1238),
    (707.0912, 601.8873, 183.1104): (370, 1226),
    (718.856, 607.1928, 185.2157): (376, 1241),
}
"""Height, width [px] of rectified images by focal length and principal point, one for each day of
recording; all cameras of a day have both in common."""
_TOLERANCE_PX: Final = 0.01
_MAX_OTHER_SIZE_PX: Final = 4
"""Largest difference of sizes that counts as none."""
_ONE_COLOUR_SHARE: Final = 0.8
"""Smallest share of pixels of one colour in a border that was added: JPEG blurs its inner edge, so
borders of 6 px have 0.85 or more; those of resized KITTI images have up to 0.77."""
_ONE_COLOUR_LEVELS: Final = 16

CROP_REMEDY: Final = (
    "subtract the crop's offset from the principal point, or scale the matrix's first two rows "
    "with the image, or give the original images (where only the right or bottom is cut off, all "
    "is well)"
)
"""Remedy for images that were cropped or resized without their camera matrix."""


def kitti_size_doubt(
    camera_matrix: Float64[np.ndarray, "3 columns"],
    image_size: tuple[int, int],
    read_image: Callable[[], UInt8[np.ndarray, "height width 3"] | None] = lambda: None,
) -> str | None:
    """Find a camera matrix of KITTI's own images that is used with others; None: there is none.

    Images extended at the right and bottom by one colour are no doubt: their matrix stays right.

    Args:
        camera_matrix: In pixels.
        image_size: Height, width [px].
        read_image: Function that reads the image, called if it may be an extended one.

    Returns:
        The rest of a sentence that begins with the matrix's name.
    """
    camera = (*np.diag(camera_matrix)[:2], *camera_matrix[:2, 2])
    own_size = next(
        (
            size
            for (focal_px, x, y), size in _SIZES.items()
            if np.abs(np.subtract(camera, (focal_px, focal_px, x, y))).max() <= _TOLERANCE_PX
        ),
        None,
    )
    if own_size is None:
        return None
    more = np.subtract(image_size, own_size)
    if np.abs(more).max() <= _MAX_OTHER_SIZE_PX:
        return None
    if (more >= 0).all():
        image = read_image()
        if image is None or _is_extended(image, own_size):
            return None
    return (
        f"is of KITTI's images of {own_size[0]}x{own_size[1]} (height x width), but images "
        f"are {image_size[0]}x{image_size[1]}: they were probably cropped or resized without it"
    )


def _is_extended(image: UInt8[np.ndarray, "height width 3"], size: tuple[int, int]) -> bool:
    """Test if an image has a single colour at the right and below a size."""
    border = np.concatenate(
        (image[size[0] :].reshape(-1, 3), image[: size[0], size[1] :].reshape(-1, 3))
    ).astype(np.int16)
    is_close = (np.abs(border - np.median(border, axis=0)) <= _ONE_COLOUR_LEVELS).all(axis=1)
    return bool(is_close.mean() >= _ONE_COLOUR_SHARE)

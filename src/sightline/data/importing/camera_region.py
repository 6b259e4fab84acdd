"""Binning and region of interest of CameraInfo."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float64


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ImageRegion:
    """Camera matrix of the published images."""

    matrix: Float64[np.ndarray, "3 4"]
    size: tuple[int, int] | None
    """Height, width [px] of the images for the matrix; None: unknown."""
    notes: tuple[str, ...] = ()


def region_of_image(
    info: Any,  # noqa: ANN401 - a message
    full_matrix: Float64[np.ndarray, "3 4"],
    image_size: tuple[int, int] | None,
) -> ImageRegion:
    """Adapt a full-resolution camera matrix to the region of interest and the binning.

    sensor_msgs/CameraInfo defines K, P and the size for the full resolution. Some drivers still
    publish full images, or write the images' own size with the full matrix: then the principal
    point, which is near the images' centre, decides which resolution the matrix is for.

    Args:
        info: A CameraInfo message.
        full_matrix: K or P of the message.
        image_size: Height, width [px] of the images; None: none could be read.
    """
    # Simple publishers fill in only the matrix.
    full = (int(info.height), int(info.width)) if info.height and info.width else None
    binning = max(int(info.binning_x), 1), max(int(info.binning_y), 1)
    roi = info.roi
    offset = int(roi.x_offset), int(roi.y_offset)
    region_size = (int(roi.height), int(roi.width)) if roi.height and roi.width else full
    if binning == (1, 1) and offset == (0, 0) and region_size == full:
        return ImageRegion(matrix=full_matrix, size=full)
    matrix = full_matrix.copy()
    matrix[:2] -= np.outer(offset, full_matrix[2])
    matrix[:2] /= np.array(binning)[:, None]
    size = (
        None
        if region_size is None
        else (region_size[0] // binning[1], region_size[1] // binning[0])
    )
    if (
        size is not None
        and image_size is not None
        and np.abs(np.subtract(size, image_size)).max() < 2
    ):
        size = image_size  # half of an odd number of rows may be rounded either way
    description = (
        f"CameraInfo has binning {binning[0]}x{binning[1]} and a region that begins at "
        f"{offset[0]}, {offset[1]}"
    )
    applied = ImageRegion(
        matrix=matrix, size=size, notes=(f"{description}: the camera's matrix is converted",)
    )
    if image_size is None or size == image_size or full != image_size:
        return applied
    image_centre = np.array(image_size[::-1]) / 2
    distances = [np.linalg.norm(each[:2, 2] - image_centre) for each in (matrix, full_matrix)]
    if distances[0] < distances[1]:
        return ImageRegion(matrix=matrix, size=image_size, notes=applied.notes)
    note = f"{description}, but images have the full size: the camera's matrix is used unchanged"
    return ImageRegion(matrix=full_matrix, size=full, notes=(note,))

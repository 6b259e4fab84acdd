"""Pictures of frames, as files."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from sightline.data.image_file import write_rgb
from sightline.data.kitti_trees import Velodyne
from sightline.data.open import open_dataset
from sightline.structures.sample import CameraLidarSample

DrawSample = Callable[[CameraLidarSample], UInt8[np.ndarray, "height width 3"]]
"""Function that draws a sample with a task's prediction."""


def write_frame_picture(
    data: Path, frame: str, out: Path, *, draw: DrawSample, velodyne: Velodyne | None = None
) -> Path:
    """Draw one frame to a PNG file.

    Args:
        data: Folder of the data set; see `open_dataset`.
        frame: Name of the frame.
        out: The PNG file.
        draw: Function that draws the picture.
        velodyne: The sweeps' folder in an object tree. None: velodyne, or else velodyne_reduced.

    Returns:
        `out`.

    Raises:
        ValueError: The data lacks the frame, one of its files is faulty, or `out` cannot be
            written.
    """
    write_rgb(out, draw(open_dataset(data, sample_list=(frame,), velodyne=velodyne)[0]))
    return out

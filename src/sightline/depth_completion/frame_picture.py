"""Picture of a frame with completed depth."""

import numpy as np
from jaxtyping import UInt8

from sightline.depth_completion.predictor import Completer
from sightline.structures.sample import CameraLidarSample
from sightline.visualization.sheet import frame_sheet


def draw_completed(
    sample: CameraLidarSample, completer: Completer
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw the page of a sample, with completed depth if it has a sweep."""
    dense = completer(sample) if sample.points is not None else None
    return frame_sheet(sample, dense, dense_name=completer.name)

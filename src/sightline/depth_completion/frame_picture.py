"""A frame with its depth completed, to look at."""

import numpy as np
from jaxtyping import UInt8

from sightline.depth_completion.predictor import Completer
from sightline.structures.sample import CameraLidarSample
from sightline.visualization.sheet import frame_sheet


def draw_completed(
    sample: CameraLidarSample, completer: Completer
) -> UInt8[np.ndarray, "height width 3"]:
    """The page of a sample, with its depth completed where it has a sweep."""
    dense = completer(sample) if sample.points is not None else None
    return frame_sheet(sample, dense, dense_name=completer.name)

"""Depth maps of whole data sets as files in KITTI's format."""

from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float32
from torch import Tensor

from sightline.data.depth_png import MAX_DEPTH_M, write_depth_png
from sightline.structures.predictions import DepthMap


def write_depth(path: Path, answer: DepthMap) -> None:
    """Writes the depths as a 16-bit PNG; what is beyond the 256 m that it holds becomes 0, none."""
    _write(path, answer.depth_m)


def write_uncertainty(path: Path, answer: DepthMap) -> None:
    """Writes the expected absolute errors in the same format; one that is infinite becomes 0.

    Raises:
        ValueError: The map tells none.
    """
    if answer.uncertainty_m is None:
        raise ValueError("the depth map tells no expected error; leave the uncertainty out")
    _write(path, torch.where(answer.uncertainty_m.isinf(), 0.0, answer.uncertainty_m))


def _write(path: Path, values_m: Float32[Tensor, "height width"]) -> None:
    values = values_m.cpu().numpy()
    # One stray return beyond the format's reach must not end the job of a whole data set.
    too_far = np.isfinite(values) & (values > MAX_DEPTH_M)
    write_depth_png(path, np.where(too_far, np.float32(0), values))

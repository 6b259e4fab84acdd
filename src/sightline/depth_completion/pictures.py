"""Training pictures: input, E-Point, prediction and error of a sample."""

import numpy as np
from jaxtyping import Float, UInt8
from torch import Tensor

from sightline.depth_completion.examples import DepthBatch
from sightline.depth_completion.model import DepthCompletionOutput
from sightline.visualization.depth import colorize_depth, colorize_error
from sightline.visualization.lettering import with_title

_POINT_PX = 3  # drawn size of a measurement


def training_picture(
    batch: DepthBatch, output: DepthCompletionOutput
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw the maps of a batch's first sample, one below the other, each with a title.

    From the top: image, sparse depth, E-Point (if the network has one), predicted depth, expected
    error (if the network estimates it) in the colours of depth, and error (if the batch has the
    truth).
    """
    image = (batch.image[0].detach().cpu() * 255).round().byte().permute(1, 2, 0).numpy()
    sparse = colorize_depth(_first(batch.sparse_depth_m), point_size_px=_POINT_PX)
    maps = [with_title(image, "image"), with_title(sparse, "sparse depth, given")]
    for title, values_m in (
        ("E-Point, predicted", output.e_point_m),
        ("depth, predicted", output.depth_m),
        ("expected error, predicted", output.uncertainty_m),
    ):
        if values_m is not None:
            maps.append(with_title(colorize_depth(_first(values_m)), title))
    if batch.depth_m is not None:
        depth_m, truth_m = _first(output.depth_m), _first(batch.depth_m)
        error = colorize_error(depth_m, truth_m, point_size_px=_POINT_PX)
        maps.append(with_title(error, "error: prediction against truth"))
    return np.concatenate(maps)


def _first(depth_m: Tensor) -> Float[Tensor, "height width"]:
    return depth_m[0, 0].detach().float().cpu()

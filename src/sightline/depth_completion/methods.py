"""The completion methods by name."""

from typing import assert_never

import numpy as np
from jaxtyping import Float32
from torch import Tensor

from sightline.depth_completion.adaptive import FIRST_EDITION, AdaptiveConfig, adaptive_depth
from sightline.depth_completion.classical import classical_depth
from sightline.depth_completion.interpolation import linear_depth, nearest_depth
from sightline.depth_completion.method_names import AdaptiveEdition, Method
from sightline.geometry.wrong_types import named_arguments
from sightline.structures.predictions import DepthMap


@named_arguments
def complete_depth(
    sparse_depth_m: Float32[Tensor, "height width"] | Float32[np.ndarray, "height width"],
    method: Method,
) -> DepthMap:
    """Complete a sparse depth map [m], 0 = no measurement, with the method's default settings.

    Works on the CPU; a tensor on another device is copied. An empty map gives an empty result
    without valid pixels.

    Raises:
        ValueError: The map contains invalid depths.
    """
    sparse = (
        sparse_depth_m.numpy(force=True) if isinstance(sparse_depth_m, Tensor) else sparse_depth_m
    )
    match method:
        case "nearest":
            return nearest_depth(sparse)
        case "linear":
            return linear_depth(sparse)
        case "classical":
            return classical_depth(sparse)
        case "adaptive":
            return adaptive_depth(sparse)
        case _:
            assert_never(method)


@named_arguments
def filling_config(edition: AdaptiveEdition) -> AdaptiveConfig:
    """Settings of an edition of adaptive completion."""
    return FIRST_EDITION if edition == "first" else AdaptiveConfig()


@named_arguments
def starting_depth(
    sparse_depth_m: Float32[Tensor, "height width"], edition: AdaptiveEdition = "first"
) -> DepthMap:
    """Complete a map as the filled input of networks, in training and in use."""
    return adaptive_depth(sparse_depth_m.numpy(force=True), filling_config(edition))

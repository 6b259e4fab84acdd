"""The depth completion network as what other engines run."""

from functools import partial

import torch
from torch import Tensor

from sightline.depth_completion.model import DepthCompletionNet
from sightline.depth_completion.processing import processing
from sightline.export.graph import Cases, ExportGraph
from sightline.export.metadata import ExportMetadata
from sightline.inference.network import LoadedNetwork

MAX_DIFFERENCE_MM = 1.0
"""An exported network may differ by so much from PyTorch's in any pixel of any output.

Both compute in float32, whose step is 0.008 mm at 85 m; the order of sums differs. Measured on
networks with random weights: 0.22 mm at most (docs/results.md has the shipped ones)."""

_EXAMPLE_IN_STRIDES = (4, 6)  # height and width; they stand for any
_SIZES_IN_STRIDES = ((5, 7), (8, 13))  # of the cases; other than the example's
_FARTHEST_M = 85.0
_DENSITY = 0.05  # share of pixels with a return, about as a 64-beam sweep gives


def export_graph(loaded: LoadedNetwork[DepthCompletionNet]) -> ExportGraph:
    """The whole network; its outputs must agree within `MAX_DIFFERENCE_MM`.

    The cases are random inputs of two sizes, with and without camera and LiDAR.
    """
    network = loaded.network
    return ExportGraph(
        module=network,
        example_inputs=example_inputs(network),
        metadata=ExportMetadata(
            task=loaded.weights.task,
            config=loaded.weights.config,
            stride=network.stride,
            provenance=loaded.provenance,
            processing=processing(network),
        ),
        cases=partial(_cases, network.stride, takes_filled_depth=network.takes_filled_depth),
        max_difference=MAX_DIFFERENCE_MM,
        unit="mm",
        scale=1e3,
    )


def example_inputs(network: DepthCompletionNet) -> dict[str, Tensor]:
    """Inputs by the names that the network's `forward` takes."""
    size = tuple(number * network.stride for number in _EXAMPLE_IN_STRIDES)
    channels = {"image": 3, "sparse_depth_m": 1}
    if network.takes_filled_depth:
        channels["filled_depth_m"] = 1
    # Each a tensor of its own: the exporter takes one that stands twice for a single input.
    return {name: torch.ones(1, count, *size) for name, count in channels.items()}


def _cases(stride: int, *, takes_filled_depth: bool) -> Cases:
    generator = torch.Generator().manual_seed(0)
    cases = {}
    for blocks in _SIZES_IN_STRIDES:
        height, width = (number * stride for number in blocks)
        inputs = _random_inputs((height, width), generator, takes_filled_depth=takes_filled_depth)
        size = f"{height}x{width}"
        black = torch.zeros_like(inputs["image"])
        empty = torch.zeros_like(inputs["sparse_depth_m"])
        cases[size] = inputs
        cases[f"{size}, no camera"] = {**inputs, "image": black}
        cases[f"{size}, no LiDAR"] = {**inputs, "sparse_depth_m": empty}
    return cases


def _random_inputs(
    size: tuple[int, int], generator: torch.Generator, *, takes_filled_depth: bool
) -> dict[str, Tensor]:
    depth_m = 1 + (_FARTHEST_M - 1) * torch.rand(1, 1, *size, generator=generator)
    is_measured = torch.rand(1, 1, *size, generator=generator) < _DENSITY
    inputs = {
        "image": torch.rand(1, 3, *size, generator=generator),
        "sparse_depth_m": torch.where(is_measured, depth_m, 0.0),
    }
    return {**inputs, "filled_depth_m": depth_m} if takes_filled_depth else inputs

"""Export graph of the depth completion network."""

from functools import partial

import torch
from torch import Tensor

from sightline.depth_completion.model import DepthCompletionNet
from sightline.depth_completion.processing import processing
from sightline.export.graph import Cases, ExportGraph
from sightline.export.metadata import ExportMetadata
from sightline.inference.network import LoadedNetwork

MAX_DIFFERENCE_MM = 1.0
"""Largest allowed difference between an exported network and PyTorch in any pixel of any output.

Both compute in float32, whose step is 0.008 mm at 85 m; the order of sums differs. Measured on
networks with random weights: 0.22 mm at most (for shipped weights see docs/results/depth.md)."""

_EXAMPLE_IN_STRIDES = (4, 6)  # height and width; both are dynamic in the graph
_SIZES_IN_STRIDES = ((5, 7), (8, 13))  # sizes of the cases; different from the example's
_MAX_DEPTH_M = 85.0
_DENSITY = 0.05  # share of pixels with a return, as in a 64-beam sweep


def export_graph(loaded: LoadedNetwork[DepthCompletionNet]) -> ExportGraph:
    """Export graph of the whole network; its outputs must agree within `MAX_DIFFERENCE_MM`.

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
    """Example inputs by the argument names of the network's `forward`."""
    size = tuple(number * network.stride for number in _EXAMPLE_IN_STRIDES)
    channels = {"image": 3, "sparse_depth_m": 1}
    if network.takes_filled_depth:
        channels["filled_depth_m"] = 1
    # Separate tensors: the exporter merges inputs that share one tensor.
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
    depth_m = 1 + (_MAX_DEPTH_M - 1) * torch.rand(1, 1, *size, generator=generator)
    is_measured = torch.rand(1, 1, *size, generator=generator) < _DENSITY
    inputs = {
        "image": torch.rand(1, 3, *size, generator=generator),
        "sparse_depth_m": torch.where(is_measured, depth_m, 0.0),
    }
    return {**inputs, "filled_depth_m": depth_m} if takes_filled_depth else inputs

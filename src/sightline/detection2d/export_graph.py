"""Export graph of the 2D detectors for other engines: boxes are decoded, not yet suppressed."""

from functools import partial

import torch
from torch import Tensor

from sightline.detection2d.model import Detector
from sightline.detection2d.processing import processing
from sightline.export.graph import Cases, ExportGraph
from sightline.export.metadata import ExportMetadata
from sightline.inference.network import LoadedNetwork

MAX_DIFFERENCE = 0.02
"""Largest difference of an exported network from PyTorch: boxes in pixels; scores and gates differ
a thousand times less.

Both compute in float32, whose step is 0.0001 px at the right border; the order of sums differs."""

_EXAMPLE_SIZE = (288, 416)  # any size would do
_CASE_SIZES = ((320, 448), (288, 640))  # other than the example's
_DENSITY = 0.05  # share of pixels with a point, about that of a 64-beam sweep


def export_graph(loaded: LoadedNetwork[Detector]) -> ExportGraph:
    """Make the graph of the whole network, whose outputs must agree within `MAX_DIFFERENCE`.

    The test cases are random inputs of two sizes, with and without camera and LiDAR.
    """
    network = loaded.network
    return ExportGraph(
        module=network,
        example_inputs=_random_inputs(network.input_names, _EXAMPLE_SIZE, torch.Generator()),
        metadata=ExportMetadata(
            task=loaded.weights.task,
            config=loaded.weights.config,
            stride=network.stride,
            provenance=loaded.provenance,
            processing=processing(network),
        ),
        cases=partial(_cases, network.input_names),
        max_difference=MAX_DIFFERENCE,
    )


def _cases(names: tuple[str, ...]) -> Cases:
    generator = torch.Generator().manual_seed(0)
    cases = {}
    for size in _CASE_SIZES:
        inputs = _random_inputs(names, size, generator)
        told = f"{size[0]}x{size[1]}"
        cases[told] = inputs
        for name, sensor in (("image", "camera"), ("lidar", "LiDAR")):
            if name in inputs and len(inputs) > 1:
                cases[f"{told}, no {sensor}"] = {**inputs, name: torch.zeros_like(inputs[name])}
    return cases


def _random_inputs(
    names: tuple[str, ...], size: tuple[int, int], generator: torch.Generator
) -> dict[str, Tensor]:
    image, lidar = (torch.rand(1, 3, *size, generator=generator) for _ in range(2))
    has_point = torch.rand(1, 1, *size, generator=generator) < _DENSITY
    inputs = {"image": image, "lidar": lidar * has_point}
    return {name: inputs[name] for name in names}

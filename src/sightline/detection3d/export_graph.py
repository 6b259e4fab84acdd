"""Export graphs of the detectors' stages for other engines, one for each stage.

The searches of point networks (farthest points, neighbours, nearest points) are graph inputs,
computed before; boxes are decoded and suppressed after. The number of points is fixed by the
settings; regions run in portions of a fixed size.
"""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Final

import torch
from torch import Tensor, nn

from sightline.detection3d.model import Detector3D
from sightline.detection3d.processing import first_processing, second_processing
from sightline.detection3d.stages import Proposed, Sweep
from sightline.export.graph import Cases, ExportGraph
from sightline.export.metadata import ExportMetadata
from sightline.inference.network import LoadedNetwork

MAX_DIFFERENCE: Final = 0.002
"""Largest difference of an exported network from PyTorch: thousandths of a metre, radian or logit.
Both compute in float32, whose step is 0.004 mm at 70 m; the order of sums differs."""

REGIONS_A_RUN: Final = 20
"""Number of regions in one run of an exported second stage: few frames have as many regions as the
settings allow."""

_SPREAD_M = (0.8, 0.4, 0.3)  # standard deviations of the points around a centre
_POINTS_A_CENTER = 64
_MANY_POINTS = 16_384  # for a network that takes any number
_REGIONS = 8
_BOX = (3.88, 1.63, 1.53, 0.5)  # length, width, height [m], yaw
_CASES = ("clusters", "other clusters", "one point")

Inputs = dict[str, Tensor]


def export_graphs(loaded: LoadedNetwork[Detector3D]) -> tuple[ExportGraph, ...]:
    """Make one or two graphs, whose outputs must agree within `MAX_DIFFERENCE`.

    The test cases are random clusters of points, and a sweep of one point.
    """
    detector = loaded.network
    make, config = partial(_first_inputs, detector), detector.config
    steps = first_processing(config)
    graphs = [_graph(loaded, "proposals", detector.first_name, make, steps)]
    if detector.second_name is not None:
        make = partial(_second_inputs, detector)
        steps = second_processing(config, regions_a_run=REGIONS_A_RUN)
        graphs.append(_graph(loaded, "refinement", detector.second_name, make, steps))
    return tuple(graphs)


def _graph(
    loaded: LoadedNetwork[Detector3D],
    name: str,
    stage: str,
    make: Callable[[str], Inputs],
    steps: Mapping[str, object],
) -> ExportGraph:
    module: nn.Module = loaded.network.get_submodule(stage)
    return ExportGraph(
        module=module,
        example_inputs=make(_CASES[0]),
        metadata=ExportMetadata(
            task=loaded.weights.task,
            config=loaded.weights.config,
            stride=1,
            provenance=loaded.provenance,
            processing=steps,
        ),
        cases=partial(_all_cases, make),
        max_difference=MAX_DIFFERENCE,
        name=name,
    )


def _all_cases(make: Callable[[str], Inputs]) -> Cases:
    return {name: make(name) for name in _CASES}


def _first_inputs(detector: Detector3D, case: str) -> Inputs:
    return detector.first.inputs([_sweep(detector, case)])


def _second_inputs(detector: Detector3D, case: str) -> Inputs:
    second, channels = detector.second, detector.first.feature_channels
    assert second is not None, "there is a second stage"
    sweep = _sweep(detector, case)
    generator = torch.Generator().manual_seed(_CASES.index(case))
    features = torch.randn(len(sweep), channels, generator=generator) if channels else None
    around = sweep[:: max(len(sweep) // _REGIONS, 1), :3][:_REGIONS]
    boxes = torch.cat((around, around.new_tensor([_BOX]).expand(len(around), 4)), dim=1)
    classes = torch.arange(len(boxes)) % len(detector.class_names)
    proposed = Proposed(boxes, classes, torch.ones(len(boxes)), features)
    inputs = second.regions(sweep, proposed, seed=0).inputs
    return next(region_portions(inputs))


def region_portions(inputs: Mapping[str, Tensor]) -> Iterator[Inputs]:
    """Split the inputs of one or more regions into portions; copies fill up the last one."""
    count = len(next(iter(inputs.values())))
    for start in range(0, count, REGIONS_A_RUN):
        # The last region is repeated to fill up the last portion.
        places = torch.arange(start, start + REGIONS_A_RUN).clamp(max=count - 1)
        yield {name: values[places] for name, values in inputs.items()}


def _sweep(detector: Detector3D, case: str) -> Sweep:
    """Make a reproducible random sweep within the network's range."""
    settings = detector.config.input
    generator = torch.Generator().manual_seed(1 if case == "other clusters" else 0)
    low, high = (
        torch.tensor(corner, dtype=torch.float32)
        for corner in (settings.lowest_m, settings.highest_m)
    )
    count = settings.num_points or _MANY_POINTS
    num_centers = -(-count // _POINTS_A_CENTER)
    centers = low + (high - low) * torch.rand(
        num_centers, 3, generator=generator, dtype=torch.float32
    )
    near = centers.repeat(_POINTS_A_CENTER, 1)[:count]
    scattered = near + torch.tensor(_SPREAD_M, dtype=torch.float32) * torch.randn(
        count, 3, generator=generator, dtype=torch.float32
    )
    reflectance = torch.rand(count, 1, generator=generator, dtype=torch.float32)
    inside = torch.minimum(torch.maximum(scattered, low), high)
    sweep = torch.cat((inside, reflectance), dim=1)
    return sweep[:1].expand(count, 4).contiguous() if case == "one point" else sweep

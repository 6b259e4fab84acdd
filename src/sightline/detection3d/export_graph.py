"""Export graphs of the detectors' stages for other engines, and their processing by other programs.

The searches of point networks (farthest points, neighbours, nearest points) are graph inputs,
computed before; boxes are decoded and suppressed after. The number of points is fixed by the
settings; regions run in portions of a fixed size.

The processing (docs/guides/export.md) names every number that a program without Sightline needs for
pillars and regions. For point networks it contains only classes and sweep settings: their inputs
need searches (farthest points, neighbours) that numpy lacks.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict
from functools import partial
from typing import Any, Final

import torch
from torch import Tensor

from sightline.detection3d.config import Detection3DConfig
from sightline.detection3d.detector import POINT_SEED, Detector3D
from sightline.detection3d.pillars.boxes import (
    BEST_IOU,
    CODE_STEP,
    LARGEST_CODE,
    LARGEST_LOG_SIZE,
    QUALITY_FOCUS,
    WORST_IOU,
)
from sightline.detection3d.pillars.config import PillarGridConfig
from sightline.detection3d.pillars.region_config import RegionConfig
from sightline.detection3d.pillars.regions import RANGE_SCALE_M, REGION_COUNT_SCALE
from sightline.detection3d.pillars.stage import GROUND_SHIFT_M, PILLAR_COUNT_SCALE
from sightline.detection3d.stages import Proposed, Stage
from sightline.detection3d.sweeps import Sweep
from sightline.export.graph import Cases, ExportGraph
from sightline.export.metadata import ExportMetadata
from sightline.geometry.kitti_mount import KITTI_LIDAR_HEIGHT_M
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
_PLAIN_INPUTS = "points and the indices that Sightline's searches find among them"

Inputs = dict[str, Tensor]


def export_graphs(loaded: LoadedNetwork[Detector3D]) -> tuple[ExportGraph, ...]:
    """Make one or two graphs, whose outputs must agree within `MAX_DIFFERENCE`.

    The test cases are random clusters of points, and a sweep of one point.
    """
    detector = loaded.network
    steps = first_processing(detector.config)
    inputs = partial(_first_inputs, detector)
    graphs = [_graph(loaded, "proposals", detector.first, inputs, steps)]
    if detector.second is not None:
        steps = second_processing(detector.config, regions_a_run=REGIONS_A_RUN)
        inputs = partial(_second_inputs, detector)
        graphs.append(_graph(loaded, "refinement", detector.second, inputs, steps))
    return tuple(graphs)


def _graph(
    loaded: LoadedNetwork[Detector3D],
    name: str,
    stage: Stage,
    make: Callable[[str], Inputs],
    steps: Mapping[str, object],
) -> ExportGraph:
    weights = loaded.weights
    return ExportGraph(
        module=stage,
        example_inputs=make(_CASES[0]),
        metadata=ExportMetadata(
            task=weights.task,
            config=weights.config,
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


def region_portions(
    inputs: Mapping[str, Tensor], size: int = REGIONS_A_RUN, *, fill: bool = True
) -> Iterator[Inputs]:
    """Split the inputs of one or more regions into portions; copies of the last may fill up."""
    count = len(next(iter(inputs.values())))
    for start in range(0, count, size):
        places = torch.arange(start, start + size).clamp(max=count - 1)
        portion = {name: values[start : start + size] for name, values in inputs.items()}
        yield {name: values[places] for name, values in inputs.items()} if fill else portion


def _sweep(detector: Detector3D, case: str) -> Sweep:
    """Make a reproducible random sweep within the network's range."""
    settings = detector.config.input
    generator = torch.Generator().manual_seed(1 if case == "other clusters" else 0)
    drawn: dict[str, Any] = {"generator": generator, "dtype": torch.float32}
    low, high, spread = (
        torch.tensor(corner, dtype=torch.float32)
        for corner in (settings.lowest_m, settings.highest_m, _SPREAD_M)
    )
    count = settings.num_points or _MANY_POINTS
    num_centers = -(-count // _POINTS_A_CENTER)
    centers = low + (high - low) * torch.rand(num_centers, 3, **drawn)
    near = centers.repeat(_POINTS_A_CENTER, 1)[:count]
    scattered = near + spread * torch.randn(count, 3, **drawn)
    reflectance = torch.rand(count, 1, **drawn)
    inside = torch.minimum(torch.maximum(scattered, low), high)
    sweep = torch.cat((inside, reflectance), dim=1)
    return sweep[:1].expand(count, 4).contiguous() if case == "one point" else sweep


def first_processing(config: Detection3DConfig) -> dict[str, object]:
    """Describe sweep, inputs, outputs and decoding of the first stage."""
    common = _common(config)
    if config.pillars is None:
        return {**common, "design": "points", "inputs": _PLAIN_INPUTS}
    grid = config.pillars.grid
    return {
        **common,
        "design": "pillars",
        "inputs": {
            "pillars": {
                "shape": "1 x channels x rows (along x) x columns (along y)",
                "channels": _pillar_channels(grid),
                "empty": 0.0,
            }
        },
        "grid": {
            **asdict(grid),
            "rows": grid.rows,
            "columns": grid.columns,
            "count_scale": PILLAR_COUNT_SCALE,
            "height_shift_m": GROUND_SHIFT_M,
        },
        "outputs": {
            "heat_logits": {
                "shape": "1 x classes x rows / 2 x columns / 2",
                "activation": "none: take the sigmoid",
            },
            "center_values": {
                "shape": "1 x classes x values x rows / 2 x columns / 2",
                "values": [
                    *("x, y [m] from the cell's middle", "z [m] from that on level ground"),
                    *("logarithms of length, width, height over the class's mean",),
                    *("sine and cosine of twice the yaw", "cosine and sine of the yaw"),
                    "quality, before the sigmoid",
                ],
            },
        },
        "decoding": {
            **asdict(config.centers),
            "cell_m": grid.head_cell_m,
            "largest_log_size": LARGEST_LOG_SIZE,
            "iou_of_quality": [WORST_IOU, BEST_IOU],
            "mean_quality_power": QUALITY_FOCUS,
        },
    }


def second_processing(config: Detection3DConfig, *, regions_a_run: int) -> dict[str, object]:
    """Describe regions, inputs, outputs, passes and suppression of the second stage."""
    common = {
        **_common(config),
        "regions_a_run": regions_a_run,
        "suppression": {
            "kind": "greedy, within a class, seen from above; an IoU of iou or more drops a box",
            **asdict(config.suppression),
        },
        "alignment": [asdict(each) for each in config.alignment],
    }
    if config.regions is None:
        return {**common, "design": "refinement", "inputs": _PLAIN_INPUTS}
    settings = config.regions
    return {
        **common,
        "design": "regions",
        "inputs": _region_inputs(settings),
        "regions": {
            "num_points": settings.num_points,
            "margin_m": list(settings.margin_m),
            "canonical": settings.canonical,
            "seed": POINT_SEED,
            "range_scale_m": RANGE_SCALE_M,
            "count_scale": REGION_COUNT_SCALE,
        },
        "outputs": {
            "values": {
                "shape": "regions x 8",
                "values": [
                    "moves forwards, leftwards and up by step times length, width and height",
                    "logarithms of the growth of length, width and height, over step",
                    "sine, and cosine less 1, of twice the turn",
                ],
            },
            "front_logits": {"shape": "regions", "meaning": "below 0: turned by half a turn"},
            "quality_logits": {"shape": "regions", "activation": "none: take the sigmoid"},
        },
        "decoding": {
            "step": CODE_STEP,
            "largest_code": LARGEST_CODE,
            "quality_share": settings.quality_share,
        },
        "passes": settings.passes,
        "mean_with_first": list(settings.mean_with_first),
        "axes": None if config.axes is None else asdict(config.axes),
    }


def _common(config: Detection3DConfig) -> dict[str, object]:
    """Describe the classes and the sweep of both stages."""
    return {
        "classes": [each.name for each in config.classes],
        "mean_sizes_m": [list(each.mean_size_m) for each in config.classes],
        "sweep": {
            **asdict(config.input),
            "frame": "x forward, y left, z up [m], the LiDAR lidar_height_m above the road",
            "lidar_height_m": KITTI_LIDAR_HEIGHT_M,
            "in_view_rule": "0 <= x < width, 0 <= y < height [px], in front of the camera",
        },
        "flip_test": config.flip_test,
        "boxes": "centre x, y, z, length, width, height [m], yaw [rad], in the sweep's frame",
    }


def _pillar_channels(grid: PillarGridConfig) -> list[dict[str, str]]:
    """List name, formula and unit of each channel."""
    slices = [grid.lowest_slice_m + number * grid.slice_m for number in range(grid.slices)]
    heights = [
        (f"point near {height_m:.2f} m", "max of 1 - |z - height| / slice_m, at least 0", "1")
        for height_m in slices
    ]
    rest = [
        ("number", "count_scale * log(1 + number of points)", "1"),
        ("mean height", "mean z + height_shift_m", "m"),
        ("highest", "largest z + height_shift_m", "m"),
        ("lowest", "least z + height_shift_m", "m"),
        ("offset along x", "mean of -1 to 1 across the pillar", "1"),
        ("offset along y", "mean of -1 to 1 across the pillar", "1"),
    ]
    if grid.reflectance:
        rest.append(("reflectance", "mean reflectance", "1"))
    if grid.local_window:
        around = f"of the points in {grid.local_window} x {grid.local_window} pillars"
        rest += [
            (f"local mean {axis}", f"mean {axis} {around} less that of the pillar's own", "m")
            for axis in "xyz"
        ]
        rest += [
            (f"local covariance {pair}", f"covariance {pair} {around}", "m^2")
            for pair in ("xx", "xy", "xz", "yy", "yz", "zz")
        ]
    values = heights + rest
    return [{"name": name, "formula": formula, "unit": unit} for name, formula, unit in values]


def _region_inputs(settings: RegionConfig) -> dict[str, object]:
    place = "x, y, z in the sweep's frame [m]"
    if settings.canonical:
        place = (
            "x, y, z in the box's frame, half the sizes less these, half the sizes and these [m]"
        )
    return {
        "points": {
            "shape": "regions x points x channels",
            "channels": [place, *(f"feature {each}" for each in range(settings.in_channels))],
            "empty": 0.0,
        },
        "context": {
            "shape": "regions x channels",
            "channels": [
                "logarithms of length, width and height over the class's mean",
                "distance / range_scale_m",
                "cosine and sine of the bearing less the yaw",
                "count_scale * log(1 + number of points inside)",
                "1 at the class, 0 at the others",
            ],
        },
    }

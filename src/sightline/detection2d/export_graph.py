"""Export graph of the 2D detectors and the steps around it: boxes decoded, not yet suppressed."""

from functools import partial

import torch
from torch import Tensor

from sightline.detection2d.config import CLASSES
from sightline.detection2d.model import Detector
from sightline.detection2d.placement import MAX_CANDIDATES
from sightline.detection2d.views import LEAST_STEP
from sightline.export.graph import Cases, ExportGraph
from sightline.export.metadata import ExportMetadata
from sightline.geometry.projection import DHI_HEIGHT_M, DHI_RANGE_M, DHI_REFLECTANCE
from sightline.inference.network import LoadedNetwork


def processing(network: Detector) -> dict[str, object]:
    """Describe inputs, outputs, resizing, padding, classes and suppression of a 2D detector."""
    config = network.config
    inputs = {"image": _image(), "lidar": _lidar(config.input.height_offset_m)}
    size = config.input.size
    return {
        "inputs": {name: inputs[name] for name in network.input_names},
        "outputs": _outputs(is_gated=config.fusion == "gated"),
        "classes": list(CLASSES),
        "resizing": {
            "size": None if size is None else list(size),
            "scale": config.input.scale,
            "longest_focal_px": config.input.longest_focal_px,
            "rule": (
                "size, or else both sides times scale * min(longest_focal_px / fy, 1), rounded; "
                "the calibration is resized with the image"
            ),
            "rows_above_horizon": config.input.rows_above_horizon,
            "rows_below_horizon": config.input.rows_below_horizon,
            "far_view_from_focal_px": LEAST_STEP * config.input.longest_focal_px,
            "views": (
                "without a size, frames with more rows than both together (times scale) are cut to "
                "these; near and far objects are seen at other scales: docs/models.md"
            ),
            "fewer_pixels": "mean over the area of each new pixel",
            "more_pixels": "bicubic",
        },
        "padding": {"sides": ["right", "bottom"], "value": 0.0, "multiple_of": network.stride},
        "suppression": {
            "kind": "greedy, within a class; a box goes if its IoU with a surer one is above iou",
            "iou": config.postprocess.nms_iou,
            "score_above": config.postprocess.min_score,
            "max_candidates": MAX_CANDIDATES,
            "max_detections": config.postprocess.max_detections,
        },
    }


def _image() -> dict[str, object]:
    return {
        "shape": "1 x 3 x height x width",
        "channels": [
            {"name": name, "formula": f"{name} / 255", "unit": "1", "range": [0, 1]}
            for name in ("red", "green", "blue")
        ],
        "without_sensor": 0.0,
    }


def _lidar(height_offset_m: float) -> dict[str, object]:
    formulas = {
        "depth": "1 - clip(x / x_m, 0, 1)",
        "height": "1 - clip((z + height_offset_m) / height_m, 0, 1)",
        "intensity": "1 - clip(reflectance / full_reflectance, 0, 1)",
    }
    return {
        "shape": "1 x 3 x height x width",
        "channels": [
            {"name": name, "formula": formula, "unit": "1", "range": [0, 1]}
            for name, formula in formulas.items()
        ],
        "x_m": DHI_RANGE_M,
        "height_m": DHI_HEIGHT_M,
        "height_offset_m": height_offset_m,
        "full_reflectance": DHI_REFLECTANCE,
        "points": "x, y, z [m] in the LiDAR frame with x above 0, reflectance in [0, 1]",
        "pixel": "floor(x + 0.5), floor(y + 0.5); of several points the one with the least depth",
        "without_point": 0.0,
        "without_sensor": 0.0,
    }


def _outputs(*, is_gated: bool) -> dict[str, object]:
    gates: dict[str, object] = {
        f"{sensor}_gate": {
            "shape": "1 x groups x rows x columns",
            "activation": "sigmoid, in the graph",
            "meaning": "0: the sensor's features are not used, 1: they are",
        }
        for sensor in ("camera", "lidar")
        if is_gated
    }
    return {
        "scores": {
            "shape": "1 x places x classes",
            "activation": "in the graph: probabilities from 0 to 1",
        },
        "boxes": {
            "shape": "1 x places x 4",
            "values": ["x_min", "y_min", "x_max", "y_max"],
            "unit": "pixels of the network's input, pixel 0 has its centre at 0",
            "activation": "none: decoded in the graph",
        },
        **gates,
    }


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
        size_name = f"{size[0]}x{size[1]}"
        cases[size_name] = inputs
        for name, sensor in (("image", "camera"), ("lidar", "LiDAR")):
            if name in inputs and len(inputs) > 1:
                cases[f"{size_name}, no {sensor}"] = {
                    **inputs,
                    name: torch.zeros_like(inputs[name]),
                }
    return cases


def _random_inputs(
    names: tuple[str, ...], size: tuple[int, int], generator: torch.Generator
) -> dict[str, Tensor]:
    image, lidar = (torch.rand(1, 3, *size, generator=generator) for _ in range(2))
    has_point = torch.rand(1, 1, *size, generator=generator) < _DENSITY
    inputs = {"image": image, "lidar": lidar * has_point}
    return {name: inputs[name] for name in names}

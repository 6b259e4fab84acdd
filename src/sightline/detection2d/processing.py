"""Machine-readable pre- and postprocessing of an exported 2D detector: docs/guides/export.md.

It names every number that a program without Sightline needs.
"""

from sightline.detection2d.config import CLASSES
from sightline.detection2d.model import Detector
from sightline.detection2d.postprocess import MOST_CANDIDATES
from sightline.geometry.projection import DHI_HEIGHT_M, DHI_RANGE_M, DHI_REFLECTANCE


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
            "fewer_pixels": "mean over the area of each new pixel",
            "more_pixels": "bicubic",
        },
        "padding": {"sides": ["right", "bottom"], "value": 0.0, "multiple_of": network.stride},
        "suppression": {
            "kind": "greedy, within a class; a box goes if its IoU with a surer one is above iou",
            "iou": config.postprocess.nms_iou,
            "score_above": config.postprocess.min_score,
            "max_candidates": MOST_CANDIDATES,
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

"""Steps before and after an exported depth completion network: see docs/guides/export.md.

Contains every number that a program without Sightline needs, by name.
"""

from dataclasses import asdict

import numpy as np

from sightline.depth_completion.adaptive import (
    GAUSS_SIGMA_PX,
    HOLE_COLUMNS,
    KITTI_COLUMNS,
    MAX_SPACING_PX,
    NEAR_PX,
    REACH_ABOVE,
    REACH_BELOW,
    REACH_BESIDE,
    SEARCH_COLUMNS,
    SMOOTHING_PASSES,
)
from sightline.depth_completion.adaptive_kernels import GROWTH_BELOW, MAX_HOLE_RATIO, RING_SLOPE
from sightline.depth_completion.classical import ClassicalConfig
from sightline.depth_completion.config import by_direction
from sightline.depth_completion.corrections import (
    AWAY_PX,
    BESIDE_PX,
    COLUMNS_AROUND,
    FIRST_ROWS_ABOVE,
    LAST_ROWS_ABOVE,
)
from sightline.depth_completion.method_names import Filling
from sightline.depth_completion.methods import filling_config
from sightline.depth_completion.model import DepthCompletionNet
from sightline.depth_completion.postprocess import FARTHEST_M, NEAREST_M, TRUSTED_SHARE
from sightline.depth_completion.street_depth import (
    FARTHEST_STREET_M,
    LARGEST_SCALE,
    LOWEST_CAMERA_M,
    WALL_HEIGHT_M,
)
from sightline.geometry.kitti_mount import KITTI_LIDAR_HEIGHT_M


def processing(network: DepthCompletionNet) -> dict[str, object]:
    """Describe inputs, outputs, padding, filling, corrections and smoothing of a network."""
    config = network.config
    default = config.least_correction
    return {
        "inputs": _inputs(takes_filled_depth=network.takes_filled_depth),
        "outputs": _outputs(
            has_uncertainty=config.uncertainty, has_e_point=config.shift_conv is not None
        ),
        "resizing": (
            None
            if config.focal_px is None
            else {"focal_px": config.focal_px, "largest_scale": LARGEST_SCALE}
        ),
        "padding": {
            "sides": ["top", "right"],
            "image": "edge",
            "sparse_depth_m": 0.0,
            "filled_depth_m": "edge",
            "multiple_of": network.stride,
        },
        "filling": _filling(config.filling) if network.takes_filled_depth else None,
        "keep_measured": config.keep_measured,
        "flip_test": config.flip_test,
        "corrections": {
            "rule": (
                "c = log(depth_m / filled_depth_m) becomes c * clip(|c| / least - 1, 0, 1); "
                "least is that of c's direction at the pixel"
            ),
            "least": default,
            "above": asdict(by_direction(config.least_correction_above, default=default)),
            "above_from_rows": [FIRST_ROWS_ABOVE, LAST_ROWS_ABOVE],
            "above_columns_around": COLUMNS_AROUND,
            "beside": asdict(by_direction(config.least_correction_beside, default=default)),
            "beside_to_px": [BESIDE_PX, AWAY_PX],
        },
        "range_m": [NEAREST_M, FARTHEST_M],
        "smoothing": None if config.smoothing is None else asdict(config.smoothing),
        "valid_below_share": TRUSTED_SHARE,
    }


def _filling(edition: Filling) -> dict[str, object]:
    if edition == "street":
        return {
            "method": "street",
            "rule": (
                "1 / depth = 1 / farthest_m + max(-slope / above_road_m, slope / wall_height_m); "
                "slope: metres upwards per metre along the optical axis, of a pixel's ray"
            ),
            "farthest_m": FARTHEST_STREET_M,
            "wall_height_m": WALL_HEIGHT_M,
            "lowest_camera_m": LOWEST_CAMERA_M,
            "usual_lidar_height_m": KITTI_LIDAR_HEIGHT_M,
        }
    config = filling_config(edition)
    return {
        "method": "adaptive",
        "edition": edition,
        **asdict(config),
        "softening": config.softening if np.isfinite(config.softening) else None,
        "contrast": {"above": REACH_ABOVE, "below": REACH_BELOW, "beside": REACH_BESIDE},
        "search_columns": SEARCH_COLUMNS,
        "kitti_columns": KITTI_COLUMNS,
        "gauss_sigma_px": GAUSS_SIGMA_PX,
        "near_px": NEAR_PX,
        "classical_largest_m": ClassicalConfig().max_depth_m,
        "widest_spacing_px": MAX_SPACING_PX,
        "ring_slope": RING_SLOPE,
        "growth_below": GROWTH_BELOW,
        "hole_columns": HOLE_COLUMNS,
        "widest_hole": MAX_HOLE_RATIO,
        "smoothing_passes": SMOOTHING_PASSES,
    }


def _inputs(*, takes_filled_depth: bool) -> dict[str, object]:
    depth = "metres along the optical axis"
    inputs: dict[str, object] = {
        "image": {
            "shape": "1 x 3 x height x width",
            "channels": ["red / 255", "green / 255", "blue / 255"],
            "unit": "1",
            "range": [0, 1],
            "without_sensor": 0.0,
        },
        "sparse_depth_m": {
            "shape": "1 x 1 x height x width",
            "channels": [depth],
            "unit": "m",
            "pixel": "floor(x + 0.5), floor(y + 0.5); of several points the nearest",
            "without_point": 0.0,
        },
    }
    if takes_filled_depth:
        inputs["filled_depth_m"] = {
            "shape": "1 x 1 x height x width",
            "channels": [f"{depth}, as filling says"],
            "unit": "m",
        }
    return inputs


def _outputs(*, has_uncertainty: bool, has_e_point: bool) -> dict[str, object]:
    plane = {"shape": "1 x 1 x height x width", "unit": "m", "activation": "in the graph"}
    outputs: dict[str, object] = {"depth_m": {**plane, "meaning": "depth, not clipped"}}
    if has_uncertainty:
        outputs["uncertainty_m"] = {**plane, "meaning": "expected absolute error"}
    if has_e_point:
        outputs["e_point_m"] = {**plane, "meaning": "intermediate map of the network: not needed"}
    return outputs

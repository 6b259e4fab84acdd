"""Machine-readable pre- and postprocessing of an exported 3D detector: docs/guides/export.md.

It names every number that a program without Sightline needs for the compact stages (pillars,
regions). For point networks it contains only classes and sweep settings: their inputs need searches
(farthest points, neighbours) that numpy lacks.
"""

from dataclasses import asdict

from sightline.detection3d.center_coding import LARGEST_LOG_SIZE
from sightline.detection3d.detector_config import Detection3DConfig
from sightline.detection3d.passes import POINT_SEED
from sightline.detection3d.pillar_config import PillarGridConfig
from sightline.detection3d.pillar_detections import QUALITY_FOCUS
from sightline.detection3d.pillar_features import GROUND_SHIFT_M, PILLAR_COUNT_SCALE
from sightline.detection3d.quality import BEST_IOU, WORST_IOU
from sightline.detection3d.region_coding import CODE_STEP, LARGEST_CODE
from sightline.detection3d.region_config import RegionConfig
from sightline.detection3d.regions import RANGE_SCALE_M, REGION_COUNT_SCALE
from sightline.geometry.kitti_mount import KITTI_LIDAR_HEIGHT_M

_PLAIN_INPUTS = "points and the indices that Sightline's searches find among them"


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
        ("reflectance", "mean reflectance", "1"),
    ]
    told = heights + (rest if grid.reflectance else rest[:-1])
    return [{"name": name, "formula": formula, "unit": unit} for name, formula, unit in told]


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

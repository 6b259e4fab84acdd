"""3D detection all around the LiDAR: a whole turn in four quarters, each turned to look ahead.

The networks have learned from objects ahead. Each quarter shows its objects from where the network
knows them, and turning the sweep by right angles turns the detections, which one grid over the
whole turn does not.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32
from torch import Tensor

from sightline.detection3d.config import Detection3DConfig
from sightline.detection3d.detector import Detector3D
from sightline.detection3d.suppression import suppress_boxes
from sightline.detection3d.sweeps import Sweep, draw_points, points_in_range
from sightline.files.weights import fill_network
from sightline.geometry.boxes3d import Boxes3D
from sightline.geometry.transforms import wrap_angle
from sightline.inference.network import LoadedNetwork
from sightline.structures.predictions import Detections3D

QUARTERS: Final = 4
NEAR_M, FAR_M = 70.4, 100.8
"""Distances up to which all directions are searched: that of the networks' own grid ahead, and a
longer one, at twice the work."""
_FAR_SHARE: Final = 0.001  # of the points, beyond the near distance, from which the far one is used
_SEAM_M: Final = 1.0  # by which a quarter's detections may reach into the next one
_OWN_CAR_M: Final = 0.5  # from a box to the LiDAR that its car carries
_BLOCK_CELLS: Final = 8  # a grid has whole blocks of so many cells along each side
_SEED: Final = 0  # for drawing points: results are reproducible


def wide_network(loaded: LoadedNetwork[Detector3D], range_m: float) -> LoadedNetwork[Detector3D]:
    """Give a network of pillars the grid of a quarter; its weights fit grids of any size.

    Args:
        loaded: The network.
        range_m: Distance up to which the grid reaches in all directions of the quarter.
    """
    config = wide_config(loaded.network.config, range_m)
    network = Detector3D(config)
    fill_network(network, loaded.network.state_dict())
    return replace(loaded, network=network.eval().requires_grad_(requires_grad=False))


def wide_config(config: Detection3DConfig, range_m: float) -> Detection3DConfig:
    """Widen the grid and the range of the points to a quarter of a turn.

    Raises:
        ValueError: The first stage has no grid, or the grid would be too large.
    """
    if config.pillars is None:
        raise ValueError("only networks of pillars detect all around, and this one is of points")
    block_m = _BLOCK_CELLS * config.pillars.grid.cell_m
    ahead_m = _whole(range_m, block_m)
    aside_m = _whole(range_m * math.sin(math.pi / QUARTERS) + _SEAM_M, block_m)
    grid = replace(config.pillars.grid, x_m=(0.0, ahead_m), y_m=(-aside_m, aside_m))
    seen = replace(
        config.input,
        lowest_m=(0.0, -aside_m, config.input.lowest_m[2]),
        highest_m=(ahead_m, aside_m, config.input.highest_m[2]),
        in_view=False,
    )
    return replace(config, pillars=replace(config.pillars, grid=grid), input=seen)


def _whole(length_m: float, block_m: float) -> float:
    return math.ceil(length_m / block_m - 1e-6) * block_m


def search_range_m(points: Float32[Tensor, "num_points 4"]) -> float:
    """Choose the distance to search by the reach of a sweep; many have hardly a far point."""
    is_far = points[:, :2].norm(dim=1) > NEAR_M
    return FAR_M if int(is_far.sum()) > _FAR_SHARE * len(points) else NEAR_M


def quarter_sweeps(
    points: Float32[Tensor, "num_points 4"], config: Detection3DConfig
) -> list[Sweep]:
    """Turn a sweep so that each quarter lies ahead, and prepare it as `network_sweep` does.

    Quarter k is turned clockwise by k right angles, which is exact.
    """
    return [
        draw_points(
            points_in_range(_turned(points, -quarter), config.input),
            config.input,
            np.random.default_rng(_SEED),
        )
        for quarter in range(QUARTERS)
    ]


def join_quarters(found: Sequence[Detections3D], config: Detection3DConfig) -> Detections3D:
    """Turn the quarters' detections back, and keep each object once, by descending score.

    A quarter answers for its own sector and a metre beyond; of overlapping boxes of a class, the
    best-scored one stays. A box around the LiDAR itself is that of its own car, and is left out.
    """
    kept = []
    for quarter, each in enumerate(found):
        is_kept = _is_ahead(each.boxes.tensor) & ~_holds_lidar(each.boxes.tensor)
        own = is_kept.nonzero()[:, 0]
        boxes = _turned(each.boxes.tensor[own], quarter)
        boxes[:, 6] = wrap_angle(boxes[:, 6] + quarter * (math.pi / 2))
        names = tuple(each.class_names[index] for index in own.tolist())
        kept.append(Detections3D(class_names=names, boxes=Boxes3D(boxes), scores=each.scores[own]))
    names = tuple(name for each in kept for name in each.class_names)
    boxes = torch.cat([each.boxes.tensor for each in kept])
    scores = torch.cat([each.scores for each in kept])
    known = {entry.name: index for index, entry in enumerate(config.classes)}
    labels = torch.tensor([known[name] for name in names], dtype=torch.int64)
    chosen = suppress_boxes(boxes, scores, config.suppression, labels=labels)
    return Detections3D(
        class_names=tuple(names[index] for index in chosen.tolist()),
        boxes=Boxes3D(boxes[chosen]),
        scores=scores[chosen],
    )


def _is_ahead(boxes: Float[Tensor, "num_boxes 7"]) -> Bool[Tensor, " num_boxes"]:
    """Test whether centres lie within 45 degrees of straight ahead, or at most a metre beyond."""
    return boxes[:, 1].abs() - boxes[:, 0] <= math.sqrt(2) * _SEAM_M


def _holds_lidar(boxes: Float[Tensor, "num_boxes 7"]) -> Bool[Tensor, " num_boxes"]:
    """Test whether the LiDAR lies in a box, seen from above, or hardly beside it."""
    x, y, cos, sin = boxes[:, 0], boxes[:, 1], boxes[:, 6].cos(), boxes[:, 6].sin()
    along, across = (x * cos + y * sin).abs(), (y * cos - x * sin).abs()
    length, width = boxes[:, 3], boxes[:, 4]
    return (along <= length / 2 + _OWN_CAR_M) & (across <= width / 2 + _OWN_CAR_M)


def _turned(rows: Float[Tensor, "rows columns"], quarters: int) -> Float[Tensor, "rows columns"]:
    """Turn x and y counter-clockwise by right angles."""
    turned = rows.clone()
    x, y = rows[:, 0], rows[:, 1]
    for _ in range(quarters % QUARTERS):
        x, y = -y, x
    turned[:, 0], turned[:, 1] = x, y
    return turned

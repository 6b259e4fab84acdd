"""First stage of 3D detection: a map of pillars for the network, and boxes from what it gives."""

from typing import Any, NamedTuple

import numpy as np

from kitti_frame import Array, Steps, single
from rotated_boxes import iou_from_above, suppress, weighted_mean, wrap


class Proposals(NamedTuple):
    """Boxes (x, y, z, length, width, height, yaw), their classes and scores."""

    boxes: Array
    classes: Array
    scores: Array


def pillar_map(xyz: Array, grid: Steps) -> Array:
    """Describe the points in each pillar: 1 x channels x rows (along x) x columns (along y)."""
    values = xyz.astype(np.float64)
    place = (values[:, :2] - [grid["x_m"][0], grid["y_m"][0]]) / grid["cell_m"]
    inside = ((place >= 0) & (place < [grid["rows"], grid["columns"]])).all(axis=1)
    inside &= (values[:, 2] >= grid["z_m"][0]) & (values[:, 2] <= grid["z_m"][1])
    place, z = place[inside], values[inside, 2]
    pillar = place.astype(int) @ [grid["columns"], 1]
    number, last = grid["rows"] * grid["columns"], grid["slices"] - 1
    count = np.bincount(pillar, minlength=number)
    means = [
        np.bincount(pillar, each, number) / count.clip(1)
        for each in (z, *(2 * (place % 1) - 1).T)  # offsets: -1 to 1 across the pillar
    ]
    level = ((z - grid["lowest_slice_m"]) / grid["slice_m"]).clip(0, last)
    below = level.astype(int)
    slices, highest, lowest = (
        np.zeros((number, last + 1)),
        np.full(number, -9e9),
        np.full(number, 9e9),
    )
    np.maximum.at(slices, (pillar, below), 1 - (level - below))
    np.maximum.at(slices, (pillar, (below + 1).clip(max=last)), level - below)
    np.maximum.at(highest, pillar, z)
    np.minimum.at(lowest, pillar, z)
    heights = np.stack((means[0], highest, lowest), axis=1) + grid["height_shift_m"]
    numbers = grid["count_scale"] * np.log1p(count)[:, None]
    heights = np.where(count[:, None] > 0, heights, 0)
    channels = np.concatenate((slices, numbers, heights, np.stack(means[1:], axis=1)), axis=1)
    shaped = channels.reshape(1, grid["rows"], grid["columns"], -1)
    return np.ascontiguousarray(shaped.transpose(0, 3, 1, 2), np.float32)


def propose(session: Any, steps: Steps, xyz: Array) -> Proposals:  # noqa: ANN401 - onnxruntime's
    """Run the network, with a flip test also on the mirrored map, and decode its boxes."""
    pillars, grid = pillar_map(xyz, steps["grid"]), steps["grid"]
    heat, values = session.run(["heat_logits", "center_values"], {"pillars": pillars})
    if steps["flip_test"]:
        mirrored = pillars[..., ::-1].copy()
        mirrored[:, grid["slices"] + 5] *= -1  # the offset along y
        heat_2, values_2 = session.run(["heat_logits", "center_values"], {"pillars": mirrored})
        sign = single([1, -1, 1, 1, 1, 1, -1, 1, 1, -1, 1])  # y, sines of twice the yaw, of it
        heat, values = heat + heat_2[..., ::-1], values + values_2[..., ::-1] * sign[:, None, None]
        heat, values = heat / 2, values / 2
    return find_boxes(1 / (1 + np.exp(-heat[0])), values[0], steps)


def find_boxes(heat: Array, values: Array, steps: Steps) -> Proposals:
    """Decode the boxes of warm cells, suppress them, and average what lies around those kept."""
    rule, grid = steps["decoding"], steps["grid"]
    classes, rows, columns = np.nonzero(heat >= np.float32(rule["min_heat"]))
    order = np.argsort(-heat[classes, rows, columns], kind="stable")[: rule["max_cells"]]
    classes, rows, columns = classes[order], rows[order], columns[order]
    warmth, decoded = heat[classes, rows, columns], values[classes, :, rows, columns]
    sizes = single(steps["mean_sizes_m"])[classes]
    corner = single([grid["x_m"][0], grid["y_m"][0]])
    middles = (np.stack((rows, columns), axis=1) + np.float32(0.5)) * rule["cell_m"] + corner
    z = decoded[:, 2] + sizes[:, 2] / 2 - steps["sweep"]["lidar_height_m"]
    limit = rule["largest_log_size"]
    axis = np.arctan2(decoded[:, 6], decoded[:, 7]) / 2
    is_front = decoded[:, 8] * np.cos(axis) + decoded[:, 9] * np.sin(axis) >= 0
    yaw = wrap(np.where(is_front, axis, axis + np.pi))
    grown = sizes * np.exp(decoded[:, 3:6].clip(-limit, limit))
    boxes = np.column_stack((middles + decoded[:, :2], z, grown, yaw)).astype(np.float32)
    worst, best = rule["iou_of_quality"]
    iou = worst + (best - worst) / (1 + np.exp(-decoded[:, 10]))
    scores = warmth ** (1 - rule["quality_share"]) * iou ** rule["quality_share"]
    around = np.pad(heat, ((0, 0), (1, 1), (1, 1)))
    around = np.lib.stride_tricks.sliding_window_view(around, (3, 3), axis=(1, 2)).max(axis=(3, 4))
    peaks = np.flatnonzero(warmth == around[classes, rows, columns])
    kept = peaks[suppress(boxes[peaks], classes[peaks], scores[peaks], rule["suppression_iou"])]
    kept = kept[: rule["max_boxes"]]
    own = boxes[kept]
    if rule["mean_iou"] is not None:
        is_near = iou_from_above(own, boxes) > rule["mean_iou"]
        is_near &= classes[kept, None] == classes
        is_near[np.arange(len(kept)), kept] = True
        weights = np.where(is_near, warmth * iou ** rule["mean_quality_power"], 0)
        own = weighted_mean(own, boxes, weights).astype(np.float32)
    return Proposals(own, classes[kept], scores[kept])

"""Second stage of 3D detection: the points around a box in its own frame, and the changed box."""

from typing import Any

import numpy as np

from kitti_frame import Array, Steps, single
from rotated_boxes import wrap

Inputs = dict[str, Array]


def scramble(numbers: Array | int) -> Any:  # noqa: ANN401 - as its argument
    """Hash numbers of 32 bits (Wellons 2018, lowbias32): the luck of points in the draw."""
    word = np.uint64(0xFFFFFFFF)
    mixed = np.asarray(numbers, np.uint64) & word
    for shift, factor in ((16, 0x7FEB352D), (15, 0x846CA68B)):
        mixed = ((mixed ^ (mixed >> np.uint64(shift))) * np.uint64(factor)) & word
    return mixed ^ (mixed >> np.uint64(16))


def draw_points(xyz: Array, box: Array, count: int, salt: int) -> tuple[Array, int]:
    """Draw the indices of exactly so many points in a box: the luckiest, or all and repetitions."""
    offset = xyz - box[:3]
    place = (offset[:, 0] + 1j * offset[:, 1]) * np.exp(-1j * box[6])
    inside = (np.abs(place.real) <= box[3] / 2) & (np.abs(place.imag) <= box[4] / 2)
    found = np.flatnonzero(inside & (np.abs(offset[:, 2]) <= box[5] / 2))
    number = len(found)
    if number > count:
        luck = scramble(np.uint64(salt) ^ scramble(found))
        return np.sort(found[np.argsort(luck, kind="stable")[:count]]), number
    if number == 0:
        return np.zeros(count, int), 0
    again = scramble(salt + np.arange(number, count)) * np.uint64(number) >> np.uint64(32)
    return np.concatenate((found, found[again.astype(int)])), number


def cut_regions(xyz: Array, boxes: Array, classes: Array, steps: Steps) -> Inputs:
    """Describe the points in and around each box, and the box as a whole."""
    rule, wide = steps["regions"], boxes.copy()
    wide[:, 3:6] += 2 * single(rule["margin_m"])
    seed = int(scramble(rule["seed"]))
    drawn = [
        draw_points(xyz.astype(np.float64), box, rule["num_points"], int(scramble(seed + number)))
        for number, box in enumerate(wide.astype(np.float64))
    ]
    number = single([each for _, each in drawn])
    offset = xyz[np.stack([index for index, _ in drawn])] - boxes[:, None, :3]
    cos, sin = np.cos(boxes[:, 6:]), np.sin(boxes[:, 6:])
    x, y, z = np.moveaxis(offset, 2, 0)
    place, half = (
        np.stack((cos * x + sin * y, cos * y - sin * x, z), axis=2),
        boxes[:, None, 3:6] / 2,
    )
    points = np.concatenate((place, half - place, half + place), axis=2)
    bearing = np.arctan2(boxes[:, 1], boxes[:, 0]) - boxes[:, 6]
    sizes = single(steps["mean_sizes_m"])
    context = (
        np.log(boxes[:, 3:6] / sizes[classes]),
        np.hypot(boxes[:, 0], boxes[:, 1]) / rule["range_scale_m"],
        *(np.cos(bearing), np.sin(bearing), rule["count_scale"] * np.log1p(number)),
        classes[:, None] == np.arange(len(sizes)),
    )
    points = np.where(number[:, None, None] == 0, 0, points)
    return {"points": single(points), "context": single(np.column_stack(context))}


def turn_regions(inputs: Inputs) -> Inputs:
    """Describe the same regions of boxes with their fronts at the other ends."""
    points, context = inputs["points"].copy(), inputs["context"].copy()
    points[..., :2] *= -1
    points[..., [3, 4, 6, 7]] = inputs["points"][..., [6, 7, 3, 4]]  # distances to the sides
    context[:, 4:6] *= -1  # cosine and sine of the bearing
    return {"points": points, "context": context}


def run_network(session: Any, inputs: Inputs, a_run: int) -> list[Array]:  # noqa: ANN401 - onnxruntime's
    """Run the network in portions of the size that it takes; the last one ends with copies."""
    count, names, found = len(inputs["context"]), ["values", "front_logits", "quality_logits"], []
    for start in range(0, count, a_run):
        places = np.arange(start, start + a_run).clip(max=count - 1)
        found.append(session.run(names, {name: each[places] for name, each in inputs.items()}))
    return [np.concatenate(each)[:count] for each in zip(*found, strict=True)]


def decode_regions(boxes: Array, values: Array, fronts: Array, rule: Steps) -> Array:
    """Change each box as its values say; a front logit below 0 turns it by half a turn."""
    move = rule["step"] * boxes[:, 3:6] * values[:, :3]
    place = (move[:, 0] + 1j * move[:, 1]) * np.exp(1j * boxes[:, 6])
    limit = rule["largest_code"]
    sizes = boxes[:, 3:6] * np.exp(rule["step"] * values[:, 3:6].clip(-limit, limit))
    turn = np.arctan2(values[:, 6], 1 + values[:, 7]) / 2 + np.where(fronts >= 0, 0, np.pi)
    centers = boxes[:, :3] + np.column_stack((place.real, place.imag, move[:, 2]))
    return np.column_stack((centers, sizes, wrap(boxes[:, 6] + turn))).astype(np.float32)

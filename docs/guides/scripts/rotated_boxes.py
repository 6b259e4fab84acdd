"""Boxes seen from above: overlap, suppression, means. Rows: x, y, z, length, width, height, yaw."""

import numpy as np

from kitti_frame import Array


def wrap(angle: Array) -> Array:
    """Bring angles [rad] to [-pi, pi)."""
    return np.remainder(angle + np.pi, 2 * np.pi) - np.pi


def iou_from_above(first: Array, second: Array) -> Array:
    """Compute the IoU of each of the first boxes with each of the second.

    In the frame of a first box the shared area is the integral of x, cut to the box, over y around
    the outline of the second (Green's theorem). Places are complex numbers.
    """
    a, b = first.astype(np.float64)[:, None, None], second.astype(np.float64)[None, :, None]
    middle = (b[..., 0] - a[..., 0] + 1j * (b[..., 1] - a[..., 1])) * np.exp(-1j * a[..., 6])
    corners = b[..., 3] * np.array([1, 1, -1, -1]) + 1j * b[..., 4] * np.array([-1, 1, 1, -1])
    start = middle + np.exp(1j * (b[..., 6] - a[..., 6])) * corners / 2
    edge = np.roll(start, -1, axis=-1) - start
    half_length, half_width = a[..., 3] / 2, a[..., 4] / 2
    low = start.imag.clip(-half_width, half_width)
    high = (start + edge).imag.clip(-half_width, half_width)
    slope = edge.real / np.where(edge.imag == 0, 1, edge.imag)
    x_low, x_high = (start.real + slope * (y - start.imag) for y in (low, high))

    def integral(x: Array) -> Array:  # of x cut to the box, over x
        cut = np.abs(x).clip(max=half_length)
        return cut**2 / 2 + half_length * (np.abs(x) - cut)

    is_steep = np.abs(x_high - x_low) < 1e-6
    mean = (integral(x_high) - integral(x_low)) / np.where(is_steep, 1, x_high - x_low)
    mean = np.where(is_steep, x_low.clip(-half_length, half_length), mean)
    shared = (mean * (high - low)).sum(axis=-1).clip(min=0)
    areas = a[..., 0, 3] * a[..., 0, 4], b[..., 0, 3] * b[..., 0, 4]
    return shared / (areas[0] + areas[1] - shared)


def suppress(boxes: Array, classes: Array, scores: Array, limit: float) -> list[int]:
    """Keep boxes whose IoU with each surer one of their class is up to the limit, surest first."""
    is_rival = (iou_from_above(boxes, boxes) > limit) & (classes[:, None] == classes)
    kept: list[int] = []
    for place in np.argsort(-scores, kind="stable"):
        if not is_rival[place, kept].any():
            kept.append(int(place))
    return kept


def weighted_mean(own: Array, boxes: Array, weights: Array) -> Array:
    """Average boxes by each row of weights; yaws as turns from those of the own boxes."""
    weights = weights / weights.sum(axis=1, keepdims=True)
    turn = boxes[:, 6] - own[:, 6:]
    axis = np.arctan2((weights * np.sin(2 * turn)).sum(1), (weights * np.cos(2 * turn)).sum(1)) / 2
    is_front = (weights * np.cos(turn - axis[:, None])).sum(axis=1) >= 0
    yaw = wrap(own[:, 6] + axis + np.where(is_front, 0, np.pi))
    return np.column_stack((weights @ boxes[:, :6], yaw))


def mean_of_two(boxes: tuple[Array, Array], fronts: tuple[Array, Array]) -> Array:
    """Average two results for the same boxes; fronts are log-odds that the front is right."""
    one, two = boxes
    centers, sizes = (one[:, :3] + two[:, :3]) / 2, np.sqrt(one[:, 3:6] * two[:, 3:6])
    yaws, odds = np.stack((one[:, 6], two[:, 6])), np.stack(fronts)
    axes = np.arctan2(np.sin(2 * yaws).sum(axis=0), np.cos(2 * yaws).sum(axis=0)) / 2
    front = np.where(np.cos(yaws - axes) >= 0, odds, -odds).sum(axis=0)
    return np.column_stack((centers, sizes, wrap(axes + np.where(front >= 0, 0, np.pi))))


def turn_to_axes(boxes: Array, is_turned: Array, number: int) -> tuple[Array, Array, Array]:
    """Append some boxes with so many axes; also where each box is from, and its axis."""
    again = np.flatnonzero(is_turned)
    numbers = np.repeat(np.arange(1, number), len(again))
    numbers = np.concatenate((np.zeros(len(boxes), int), numbers))
    origins = np.concatenate((np.arange(len(boxes)), np.tile(again, number - 1)))
    turned = boxes[origins]
    turned[:, 6] = wrap(turned[:, 6] + np.float32(numbers * (np.pi / number)))
    return turned, origins, numbers

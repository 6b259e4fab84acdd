"""Boxes of both detectors and the returns of a frame, in the image and in the LiDAR's frame."""

from typing import NamedTuple

import numpy as np

from kitti_frame import Array, Frame, pixels_of, project

Detections = list[tuple[str, float, Array]]
NEAR_M, MARGIN_M = 0.1, 0.05
ALONG, ACROSS = [0.5, 0.5, -0.5, -0.5] * 2, [0.5, -0.5, -0.5, 0.5] * 2
UP = [0.0] * 4 + [1.0] * 4
STARTS = [0, 1, 2, 3, 4, 5, 6, 7, 0, 1, 2, 3]
ENDS = [1, 2, 3, 0, 5, 6, 7, 4, 4, 5, 6, 7]


class Boxes(NamedTuple):
    """Detections of one detector."""

    names: Array
    scores: Array
    in_image: Array  # x_min, y_min, x_max, y_max [px]; no number: outside the image
    returns: Array  # numbers of LiDAR returns in each box


class Scene(NamedTuple):
    """Boxes and returns of a frame, to be joined."""

    frame: Frame
    size: tuple[int, int]
    image: Boxes
    sweep: Boxes
    boxes3d: Array  # x, y, z, length, width, height [m], yaw [rad]
    points: Array  # x, y, z [m] of the returns in view
    pixels: Array


def make_scene(frame: Frame, image: Detections, sweep: Detections) -> Scene:
    """Project the boxes of the sweep's detector, and count returns."""
    size = frame.rgb.shape[0], frame.rgb.shape[1]
    x, y, _ = project(frame.points, frame.camera, frame.mounting)
    places, _, _ = pixels_of(x, y, size)
    points = frame.points[places, :3].astype(np.float64)
    pixels = np.stack((x[places], y[places]), axis=1)
    boxes3d = np.array([box for _, _, box in sweep], np.float64).reshape(-1, 7)
    in_image = np.array([box for _, _, box in image], np.float64).reshape(-1, 4)
    in_image = in_image.clip(0, np.array([size[1] - 1, size[0] - 1] * 2))
    within = (pixels >= in_image[:, None, :2]) & (pixels <= in_image[:, None, 2:])
    seen = Boxes(*_names_scores(image), in_image, within.all(axis=2).sum(axis=1))
    counts = np.array([count_returns(points, box) for box in boxes3d], int)
    projected = project_boxes(frame, boxes3d, size)
    measured = Boxes(*_names_scores(sweep), projected, counts)
    return Scene(frame, size, seen, measured, boxes3d, points, pixels)


def _names_scores(found: Detections) -> tuple[Array, Array]:
    return np.array([name for name, _, _ in found], str), np.array([each[1] for each in found])


def count_returns(points: Array, box: Array) -> int:
    """Count the returns in a 3D box, which is enlarged a little."""
    x, y, z = (points - box[:3]).T
    cos, sin = np.cos(box[6]), np.sin(box[6])
    own = np.stack((cos * x + sin * y, cos * y - sin * x, z), axis=1)
    return int((np.abs(own) <= box[3:6] / 2 + MARGIN_M).all(axis=1).sum())


def project_boxes(frame: Frame, boxes: Array, size: tuple[int, int]) -> Array:
    """Bound the edges of boxes that stand upright in the camera's frame, within the image."""
    bottoms = boxes[:, :3] @ frame.mounting[:3, :3].T + frame.mounting[:3, 3]
    length, width, height = (boxes[:, [column]] for column in (3, 4, 5))
    bottoms[:, 1] += height[:, 0] / 2
    turn = -boxes[:, [6]] - np.pi / 2  # KITTI's rotation_y
    along, across = length * ALONG, width * ACROSS
    x = np.cos(turn) * along + np.sin(turn) * across
    z = np.cos(turn) * across - np.sin(turn) * along
    corners = np.stack((x, -height * UP, z), axis=2) + bottoms[:, None]
    flat = corners @ frame.camera[:, :3].T + frame.camera[:, 3]
    rows, columns = size
    sides = [(0, 0, 1), (1, 0, 0), (-1, 0, columns - 1), (0, 1, 0), (0, -1, rows - 1)]
    margins = flat @ np.array(sides, np.float64).T - [NEAR_M, 0, 0, 0, 0]
    start, end = margins[:, STARTS], margins[:, ENDS]  # a place is inside where none is negative
    crossing = start / np.where(start == end, 1, start - end)
    entry = np.where(start < 0, np.where(end < 0, np.inf, crossing), 0).max(axis=2)
    leave = np.where(end < 0, crossing, 1).min(axis=2)
    seen = entry <= leave
    shares = np.stack((np.where(seen, entry, 0), np.where(seen, leave, 0)), axis=2)[..., None]
    ends = flat[:, STARTS][:, :, None] + shares * (flat[:, ENDS] - flat[:, STARTS])[:, :, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        pixels = ends[..., :2] / ends[..., 2:]
    kept = seen[..., None, None]
    low = np.where(kept, pixels, np.inf).min(axis=(1, 2), initial=np.inf)
    high = np.where(kept, pixels, -np.inf).max(axis=(1, 2), initial=-np.inf)
    bounds = np.concatenate((low, high), axis=1).clip(0, np.array([columns - 1, rows - 1] * 2))
    return np.where(seen.any(axis=1)[:, None], bounds, np.nan)

"""Keeps road users from standing in one another and in walls, at all times of a drive."""

import numpy as np
from jaxtyping import Bool, Float, Float64


class Occupancy:
    """The ground that is taken at each of a few moments: rotated rectangles seen from above."""

    def __init__(self, num_moments: int) -> None:
        self._boxes = np.zeros((0, num_moments, 5))

    @property
    def num_moments(self) -> int:
        """Number of moments at which it is known what is taken."""
        return self._boxes.shape[1]

    def try_add(
        self,
        poses: Float[np.ndarray, "num_moments fields"],
        length: float,
        width: float,
        margin: float = 0.0,
    ) -> bool:
        """Takes the ground of a rectangle at its poses if `is_free`; says whether it did."""
        free = self.is_free(poses, length, width, margin)
        if free:
            self.take(poses, length, width)
        return free

    def is_free(
        self,
        poses: Float[np.ndarray, "num_moments fields"],
        length: float,
        width: float,
        margin: float = 0.0,
    ) -> bool:
        """Whether no ground of a rectangle is taken at its poses.

        Args:
            poses: x, y, z and yaw at each moment; further columns are ignored.
            length: Along its heading [m].
            width: Across [m].
            margin: Room to keep to all others [m]; it is not kept free for the rectangle later.
        """
        sizes = np.tile([length, width], (len(poses), 1))
        candidate = np.concatenate((poses[:, [0, 1, 3]], sizes), axis=1)
        grown = candidate + np.array([0.0, 0.0, 0.0, 2 * margin, 2 * margin])
        reach = np.hypot(self._boxes[..., 3], self._boxes[..., 4]) + np.hypot(*grown[0, 3:])
        apart = np.hypot(*np.moveaxis(self._boxes[..., :2] - grown[:, :2], -1, 0))
        near = apart < reach / 2
        if near.any():
            rows, moments = np.nonzero(near)
            return not rectangles_overlap(self._boxes[rows, moments], grown[moments]).any()
        return True

    def take(
        self, poses: Float[np.ndarray, "num_moments fields"], length: float, width: float
    ) -> None:
        """Takes the ground of a rectangle at its poses, whatever is there."""
        sizes = np.tile([length, width], (len(poses), 1))
        box = np.concatenate((poses[:, [0, 1, 3]], sizes), axis=1)
        self._boxes = np.concatenate((self._boxes, box[None]))


def rectangles_overlap(
    first: Float64[np.ndarray, "count 5"], second: Float64[np.ndarray, "count 5"]
) -> Bool[np.ndarray, " count"]:
    """Whether pairs of rectangles (x, y, yaw, length, width) overlap: no axis separates them."""
    between = second[:, :2] - first[:, :2]
    overlap = np.ones(len(first), dtype=bool)
    for box in (first, second):
        for quarter in (0.0, np.pi / 2):
            angle = box[:, 2] + quarter
            axis = np.stack((np.cos(angle), np.sin(angle)), axis=1)
            reach = _half_extent(first, angle) + _half_extent(second, angle)
            overlap &= np.abs((between * axis).sum(axis=1)) < reach
    return overlap


def _half_extent(
    boxes: Float64[np.ndarray, "count 5"], angle: Float64[np.ndarray, " count"]
) -> Float64[np.ndarray, " count"]:
    turn = boxes[:, 2] - angle
    extent: Float64[np.ndarray, " count"] = (
        np.abs(np.cos(turn)) * boxes[:, 3] + np.abs(np.sin(turn)) * boxes[:, 4]
    ) / 2
    return extent

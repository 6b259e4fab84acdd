"""Ground occupancy, which prevents collisions of road users and walls during a drive."""

import numpy as np
from jaxtyping import Bool, Float, Float64


class Occupancy:
    """Occupied ground at each of a few moments: rotated rectangles viewed from above."""

    def __init__(self, num_moments: int) -> None:
        self._boxes = np.zeros((0, num_moments, 5))

    @property
    def num_moments(self) -> int:
        """Number of moments with stored occupancy."""
        return self._boxes.shape[1]

    def try_add(
        self,
        poses: Float[np.ndarray, "num_moments fields"],
        length: float,
        width: float,
        margin: float = 0.0,
    ) -> bool:
        """Occupy a rectangle's ground at its poses if `is_free`; return whether it was free."""
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
        """Test whether the ground of a rectangle is free at all its poses.

        Args:
            poses: x, y, z and yaw at each moment; further columns are ignored.
            length: Length along its heading [m].
            width: Width across its heading [m].
            margin: Distance to all others [m]; it is not kept free for the rectangle later.
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
        """Occupy the ground of a rectangle at its poses, even if it is not free."""
        sizes = np.tile([length, width], (len(poses), 1))
        box = np.concatenate((poses[:, [0, 1, 3]], sizes), axis=1)
        self._boxes = np.concatenate((self._boxes, box[None]))


def rectangles_overlap(
    first: Float64[np.ndarray, "count 5"], second: Float64[np.ndarray, "count 5"]
) -> Bool[np.ndarray, " count"]:
    """Test pairs of rectangles (x, y, yaw, length, width) for overlap: no axis separates them."""
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

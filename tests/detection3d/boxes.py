"""Boxes that the tests of both stages share."""

import torch
from hypothesis import strategies as st


def car(x: float, y: float = 0.0, yaw: float = 0.0) -> list[float]:
    """A box of 4 x 2 x 1.5 m."""
    return [x, y, 0.0, 4.0, 2.0, 1.5, yaw]


def rows(boxes: list) -> torch.Tensor:
    """Boxes as a tensor, also none."""
    return torch.tensor(boxes, dtype=torch.float64).reshape(-1, 7)


# cars a few steps of a quarter metre from each other: every IoU from 0 to 1, and ties
near = st.tuples(
    st.integers(-24, 24).map(lambda quarter: quarter / 4), st.sampled_from([0.0, 0.5, 9.0])
).map(lambda at: car(*at))
near_boxes = st.lists(near, max_size=8)

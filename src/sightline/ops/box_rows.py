"""Checked boxes for the kernels: rows of seven float64 values."""

import numpy as np
import torch
from jaxtyping import Float64
from numpy import ndarray
from torch import Tensor

from sightline.ops.rotated_iou_kernel import LARGEST, first_bad_row, seven_columns


def box_rows(boxes: Tensor) -> Float64[Tensor, "n 7"]:
    """Convert 3D boxes to float64; a rectangle becomes a box of height 1 at z = 0."""
    boxes = boxes.double()
    if boxes.shape[1] == 7:
        return boxes
    z, height = torch.zeros_like(boxes[:, :1]), torch.ones_like(boxes[:, :1])
    return torch.cat((boxes[:, :2], z, boxes[:, 2:4], height, boxes[:, 4:]), dim=1)


def checked_box_rows(boxes: Tensor, name: str) -> Float64[Tensor, "n 7"]:
    """Check boxes and convert them as `box_rows` does, without gradient.

    Raises:
        ValueError: A NaN, an infinity, a value beyond 1e100 or a negative size; names the row.
    """
    rows = box_rows(boxes.detach())
    good = (rows.abs() <= LARGEST).all(dim=1) & (rows[:, 3:6] >= 0).all(dim=1)
    _require_none(-1 if bool(good.all()) else int(good.int().argmin()), boxes, name)
    return rows


def checked_numpy_rows(boxes: Tensor, name: str) -> Float64[ndarray, "n 7"]:
    """Check and convert boxes on a CPU, many times faster.

    Raises:
        ValueError: As `checked_box_rows`.
    """
    rows = seven_columns(np.ascontiguousarray(boxes.detach().double().numpy()))
    _require_none(first_bad_row(rows), boxes, name)
    return rows


def _require_none(bad_row: int, boxes: Tensor, name: str) -> None:
    if bad_row >= 0:
        raise ValueError(
            f"{name}[{bad_row}] is {boxes[bad_row].tolist()}, but values must be finite (up to "
            f"{LARGEST:g}) and sizes not negative: drop such boxes first"
        )

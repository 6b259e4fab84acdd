"""Box encoding relative to bird's-eye-view cells: the compact first stage's regression.

A cell encodes the centre's offset from its middle, the height of the centre, the sizes relative to
the class's mean, and the heading in two parts. The axis is the sine and cosine of twice the yaw,
which do not jump where a box looks the same from both ends. The front is the cosine and sine of the
yaw. So an uncertain front does not disturb the axis, and front and back do not cancel out.
"""

import math
from typing import Final

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from sightline.detection3d.pillar_config import PillarGridConfig
from sightline.geometry.kitti_mount import KITTI_LIDAR_HEIGHT_M
from sightline.geometry.transforms import wrap_angle

CENTER_VALUES: Final = 11
"""Number of values for each cell and class: x, y and z of the centre [m], logarithms of length,
width and height over the mean, sine and cosine of twice the yaw, cosine and sine of the yaw, and
the logit of the quality."""
AXIS: Final = slice(6, 8)
FRONT: Final = slice(8, 10)
QUALITY: Final = 10
_ASIDE: Final = 1
LARGEST_LOG_SIZE: Final = 1.0  # sizes stay within a factor of e of the mean


def cell_middles(cells: Int64[Tensor, "n 2"], grid: PillarGridConfig) -> Float[Tensor, "n 2"]:
    """Compute x and y [m] of the middles of head cells (row, column)."""
    origin = torch.tensor([grid.x_m[0], grid.y_m[0]], device=cells.device)
    return (cells + 0.5) * grid.head_cell_m + origin


def encode_centers(
    boxes: Float[Tensor, "n 7"],
    middles: Float[Tensor, "n 2"],
    mean_sizes: Float[Tensor, "n 3"],
) -> Float[Tensor, "n 10"]:
    """Encode each box relative to its cell: all values but the quality.

    Args:
        boxes: x, y, z, length, width, height, yaw (LiDAR frame, metres, radians).
        middles: x, y of the cells' middles [m].
        mean_sizes: Length, width, height of the boxes' classes [m].
    """
    yaw = boxes[:, 6:]
    parts = (
        boxes[:, :2] - middles,
        boxes[:, 2:3] - _mean_height(mean_sizes),
        torch.log(boxes[:, 3:6] / mean_sizes),
        torch.sin(2 * yaw),
        torch.cos(2 * yaw),
        torch.cos(yaw),
        torch.sin(yaw),
    )
    return torch.cat(parts, dim=1)


def decode_centers(
    values: Float[Tensor, "n values"],
    middles: Float[Tensor, "n 2"],
    mean_sizes: Float[Tensor, "n 3"],
) -> Float[Tensor, "n 7"]:
    """Decode boxes from cell values: the inverse of `encode_centers`. Yaws are in [-pi, pi).

    Sizes are limited to a factor of e from the mean.
    """
    center = torch.cat((middles + values[:, :2], values[:, 2:3] + _mean_height(mean_sizes)), dim=1)
    sizes = mean_sizes * values[:, 3:6].clamp(-LARGEST_LOG_SIZE, LARGEST_LOG_SIZE).exp()
    sine, cosine = values[:, AXIS].unbind(dim=1)
    axis = torch.atan2(sine, cosine) / 2
    ahead, aside = values[:, FRONT].unbind(dim=1)
    is_front = ahead * axis.cos() + aside * axis.sin() >= 0
    yaw = wrap_angle(torch.where(is_front, axis, axis + math.pi))
    return torch.cat((center, sizes, yaw[:, None]), dim=1)


def mirror_centers(
    values: Float[Tensor, "batch classes values rows columns"],
) -> Float[Tensor, "batch classes values rows columns"]:
    """Mirror cell values left to right.

    The grid must reach as far to the left as to the right.
    """
    sign = values.new_ones(CENTER_VALUES)
    sign[[_ASIDE, AXIS.start, FRONT.stop - 1]] = -1  # y, the sines of twice the yaw and of the yaw
    return values.flip(-1) * sign[:, None, None]


def _mean_height(mean_sizes: Float[Tensor, "n 3"]) -> Float[Tensor, "n 1"]:
    """Compute z of the centre of a mean-sized box on level ground."""
    return mean_sizes[:, 2:] / 2 - KITTI_LIDAR_HEIGHT_M

"""Boxes as changes of a proposal, told in its frame: the compact second stage's regression.

The centre moves by shares of the proposal's sizes, the sizes by logarithms, and the heading's axis
by sine and cosine of twice the turn, so that a turn has one code however it is wrapped. Whether the
front is where the proposal has it is told apart: a logit, not an angle.
"""

import math
from typing import Final

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from sightline.geometry.transforms import wrap_angle

REGION_VALUES: Final = 8
"""Of each region: centre (3), sizes (3), sine and cosine less 1 of twice the axis's turn."""
CODE_STEP: Final = 0.15  # a change of so much of the size, or by its exponential, has the code 1
LARGEST_CODE: Final = 5.0  # of sizes: within a factor of 2.1 of the proposal's


def encode_regions(
    boxes: Float[Tensor, "n 7"], proposals: Float[Tensor, "n 7"]
) -> Float[Tensor, "n 8"]:
    """Each box as a change of its proposal; the front apart: `keeps_front`.

    Both are x, y, z, length, width, height, yaw (one frame, metres, radians).
    """
    x, y, z = (boxes[:, :3] - proposals[:, :3]).unbind(dim=1)
    cos, sin = proposals[:, 6].cos(), proposals[:, 6].sin()
    offset = torch.stack((cos * x + sin * y, cos * y - sin * x, z), dim=1)
    turn = 2 * (boxes[:, 6:] - proposals[:, 6:])
    parts = (
        offset / (CODE_STEP * proposals[:, 3:6]),
        torch.log(boxes[:, 3:6] / proposals[:, 3:6]) / CODE_STEP,
        turn.sin(),
        turn.cos() - 1,
    )
    return torch.cat(parts, dim=1)


def turn_regions(values: Float[Tensor, "n 8"]) -> Float[Tensor, "n 8"]:
    """The code of each change if its proposal had its front at its other end."""
    return values * values.new_tensor([-1, -1, 1, 1, 1, 1, 1, 1])


def keeps_front(boxes: Float[Tensor, "n 7"], proposals: Float[Tensor, "n 7"]) -> Bool[Tensor, " n"]:
    """Whether a box's front is at that end of the axis that is nearer to the proposal's front."""
    return (boxes[:, 6] - proposals[:, 6]).cos() >= 0


def decode_regions(
    values: Float[Tensor, "n 8"],
    is_front_kept: Bool[Tensor, " n"],
    proposals: Float[Tensor, "n 7"],
) -> Float[Tensor, "n 7"]:
    """The changed boxes; `encode_regions` the other way round. Yaws are in [-pi, pi).

    Zeros leave a proposal as it is. A size changes by no more than a factor of 2.1.
    """
    forwards, leftwards, up = (CODE_STEP * proposals[:, 3:6] * values[:, :3]).unbind(dim=1)
    cos, sin = proposals[:, 6].cos(), proposals[:, 6].sin()
    move = torch.stack((cos * forwards - sin * leftwards, sin * forwards + cos * leftwards, up), 1)
    growth = (CODE_STEP * values[:, 3:6].clamp(-LARGEST_CODE, LARGEST_CODE)).exp()
    turn = torch.atan2(values[:, 6], 1 + values[:, 7]) / 2
    yaw = proposals[:, 6] + turn + torch.where(is_front_kept, 0.0, math.pi)
    return torch.cat(
        (proposals[:, :3] + move, proposals[:, 3:6] * growth, wrap_angle(yaw)[:, None]), dim=1
    )

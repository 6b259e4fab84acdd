"""Box residuals in the proposal's frame: the compact second stage's regression.

Centre offsets are shares of the proposal's sizes, sizes are logarithms, and the axis of the heading
is the sine and cosine of twice the turn, so that a turn has one code however it is wrapped. A
separate logit, not an angle, decides whether the front stays at the proposal's end.
"""

import math
from typing import Final

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from sightline.geometry.transforms import wrap_angle

REGION_VALUES: Final = 8
"""Number of values for each region: centre (3), sizes (3), sine, and cosine - 1, of 2 x turn."""
CODE_STEP: Final = 0.15  # offset over size, or log size ratio, with code 1
LARGEST_CODE: Final = 5.0  # size limit: a factor of 2.1 from the proposal


def encode_regions(
    boxes: Float[Tensor, "n 7"], proposals: Float[Tensor, "n 7"]
) -> Float[Tensor, "n 8"]:
    """Encode each box relative to its proposal, without the front: `keeps_front`.

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
    """Convert codes to those for proposals turned by half a turn."""
    return values * values.new_tensor([-1, -1, 1, 1, 1, 1, 1, 1])


def keeps_front(boxes: Float[Tensor, "n 7"], proposals: Float[Tensor, "n 7"]) -> Bool[Tensor, " n"]:
    """Mask of the boxes whose front is at the end nearer to the proposal's front."""
    return (boxes[:, 6] - proposals[:, 6]).cos() >= 0


def decode_regions(
    values: Float[Tensor, "n 8"],
    is_front_kept: Bool[Tensor, " n"],
    proposals: Float[Tensor, "n 7"],
) -> Float[Tensor, "n 7"]:
    """Decode boxes: the inverse of `encode_regions`. Yaws are in [-pi, pi).

    Zeros leave a proposal unchanged. A size changes by at most a factor of 2.1.
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

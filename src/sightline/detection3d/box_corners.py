"""Corner loss of boxes."""

import math

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import smooth_l1_loss

from sightline.geometry.boxes3d import Boxes3D


def corner_costs(
    predicted: Float[Tensor, "n 7"], target: Float[Tensor, "n 7"], *, knee_m: float
) -> Float[Tensor, " n"]:
    """Smooth L1 [m] of each box's corners, the mean of the eight: Qi et al. 2018 (Frustum), eq. 2.

    The cost is the smaller one of two: for the target, and for the same box facing backwards. Other
    losses teach the front.

    Args:
        predicted: x, y, z, length, width, height, yaw (metres, radians).
        target: Ground-truth boxes.
        knee_m: Error where the loss changes from quadratic to linear.
    """
    turn = target.new_tensor([0, 0, 0, 0, 0, 0, math.pi])
    corners = Boxes3D(predicted).corners()
    costs = [
        smooth_l1_loss(corners, Boxes3D(each).corners(), reduction="none", beta=knee_m)
        for each in (target, target + turn)
    ]
    forwards, backwards = (cost.sum(dim=2).mean(dim=1) for cost in costs)
    return torch.minimum(forwards, backwards)

"""Spatial propagation: each pixel's depth mixed with its neighbours', by learned weights."""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

NEIGHBOURS = 8
_INITIAL_CONFIDENCE_LOGIT = -4.0  # 2 %: an untrained network hardly changes its input


def propagate(
    depth_m: Float[Tensor, "batch 1 height width"],
    affinity_logits: Float[Tensor, "batch 8 height width"],
    confidence_logits: Float[Tensor, "batch 1 height width"],
    sparse_depth_m: Float[Tensor, "batch 1 height width"],
    *,
    steps: int,
) -> Float[Tensor, "batch 1 height width"]:
    """Mix depths `steps` times, and move measured pixels towards their measurement each time.

    Cheng et al. 2018 (CSPN), eq. 1 and 6, with two changes: the weights are normalised only where
    their magnitudes add up to more than 1, as in Park et al. 2020 (NLSPN), section 4.3, and the
    measurements are put back by a learned confidence, since outliers are among them.

    The neighbours are those of a 3x3 kernel in order, without the centre, which gets the rest of
    the weight: a constant map stays unchanged. The border's values are repeated beyond it. Logits
    of zero leave every depth without a measurement unchanged.
    """
    weights = torch.tanh(affinity_logits)
    weights = weights / weights.abs().sum(dim=1, keepdim=True).clamp(min=1)
    weight_of = torch.split(weights, 1, dim=1)
    confidence = torch.sigmoid(confidence_logits + _INITIAL_CONFIDENCE_LOGIT)
    confidence = confidence * (sparse_depth_m > 0)
    for _ in range(steps):
        change = torch.zeros_like(depth_m)
        for weight, neighbour in zip(weight_of, _neighbours(depth_m), strict=True):
            change = torch.addcmul(change, weight, neighbour - depth_m)
        depth_m = depth_m + change
        depth_m = torch.addcmul(depth_m, confidence, sparse_depth_m - depth_m)
    return depth_m


def _neighbours(maps: Tensor) -> list[Tensor]:
    height, width = maps.shape[-2:]
    padded = F.pad(maps, (1, 1, 1, 1), mode="replicate")
    offsets = [(dy, dx) for dy in range(3) for dx in range(3) if (dy, dx) != (1, 1)]
    return [padded[..., dy : dy + height, dx : dx + width] for dy, dx in offsets]

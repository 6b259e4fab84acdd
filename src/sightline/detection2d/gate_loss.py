"""Loss that trains gates to close on missing parts of the sensors' images."""

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from sightline.detection2d.health import pooled_health
from sightline.detection2d.readings import GateReading


def gate_loss(
    gates: Sequence[GateReading],
    camera_health: Float[Tensor, "batch 1 rows columns"],
    lidar_health: Float[Tensor, "batch 1 rows columns"],
) -> Float[Tensor, ""]:
    """Cross entropy of each gate with its sensor's health, the mean over all maps.

    Cells with unknown health (NaN) have no loss.
    """
    costs = [
        _cost(logits, health)
        for gate in gates
        for logits, health in (
            (gate.camera_logits, camera_health),
            (gate.lidar_logits, lidar_health),
        )
    ]
    return torch.stack(costs).mean()


def _cost(
    logits: Float[Tensor, "batch groups rows columns"],
    health: Float[Tensor, "batch 1 fine_rows fine_columns"],
) -> Float[Tensor, ""]:
    rows, columns = logits.shape[-2:]
    wanted = pooled_health(health, rows, columns).expand_as(logits)
    is_known = ~wanted.isnan()
    entropy = F.binary_cross_entropy_with_logits(
        logits.float(), wanted.nan_to_num(), reduction="none"
    )
    return (entropy * is_known).sum() / is_known.sum().clamp(min=1)

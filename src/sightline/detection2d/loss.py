"""Training loss of a 2D detector."""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from sightline.detection2d.aligned_loss import (
    AlignedLossConfig,
    AlignedLosses,
    aligned_loss,
    assign_batch,
)
from sightline.detection2d.batch import DetectionBatch
from sightline.detection2d.config import check_range
from sightline.detection2d.gate_loss import gate_loss
from sightline.detection2d.readings import HeadOutputs
from sightline.detection2d.ssd_loss import SsdLossConfig, multibox_loss


@dataclass(frozen=True, kw_only=True)
class DetectionLossConfig:
    """Settings of the training loss."""

    ssd: SsdLossConfig = SsdLossConfig()  # noqa: RUF009 - frozen
    """Loss of networks with SSD's heads."""
    aligned: AlignedLossConfig = AlignedLossConfig()  # noqa: RUF009
    """Loss of compact networks."""
    auxiliary_weight: float = 0.5
    """Weight of the losses of the streams' own heads, if there are any."""
    gate_weight: float = 0.0
    """Weight of the gate loss, which needs health maps in the examples."""

    def __post_init__(self) -> None:
        """Checks the ranges."""
        check_range("auxiliary_weight", self.auxiliary_weight, 0, 1e6)
        check_range("gate_weight", self.gate_weight, 0, 1e6)


class DetectionLosses(NamedTuple):
    """Total loss and its terms."""

    total: Float[Tensor, ""]
    classification: Float[Tensor, ""]
    boxes: Float[Tensor, ""]
    distribution: Float[Tensor, ""]
    auxiliary: Float[Tensor, ""]
    gates: Float[Tensor, ""]


def detection_loss(
    readings: HeadOutputs, batch: DetectionBatch, config: DetectionLossConfig, *, compact: bool
) -> DetectionLosses:
    """Compute the loss of all heads; in late fusion, each detector has to find all objects.

    A stream's own head has the joint head's targets at the same places, and no loss if its sensor
    is missing.

    Raises:
        ValueError: The gate loss needs health maps that the examples lack.
    """
    nothing = readings.heads[0].class_logits.new_zeros(())
    auxiliary = nothing
    if compact:
        terms, auxiliary = _compact_terms(readings, batch, config)
    else:
        found = [multibox_loss(reading, batch.targets, config.ssd) for reading in readings.heads]
        terms = [AlignedLosses(each.classification, each.boxes, nothing) for each in found]
    gates = nothing
    if config.gate_weight and readings.gates:
        if batch.camera_health is None or batch.lidar_health is None:
            raise ValueError(
                "gates are to be told which parts of the sensors' images are missing, but the "
                "examples do not say; set health to true in the examples' settings"
            )
        gates = config.gate_weight * gate_loss(
            readings.gates, batch.camera_health, batch.lidar_health
        )
    sums = [torch.stack(list(each)).sum() for each in zip(*terms, strict=True)]
    total = torch.stack([*sums, auxiliary, gates]).sum()
    return DetectionLosses(total, sums[0], sums[1], sums[2], auxiliary, gates)


def _compact_terms(
    readings: HeadOutputs, batch: DetectionBatch, config: DetectionLossConfig
) -> tuple[list[AlignedLosses], Float[Tensor, ""]]:
    """Compute the losses of each head, and of all auxiliary heads together."""
    aligned = config.aligned
    assigned = [
        assign_batch(reading, batch.targets, aligned.assignment) for reading in readings.heads
    ]
    terms = [
        aligned_loss(reading, batch.targets, assignments, aligned)
        for reading, assignments in zip(readings.heads, assigned, strict=True)
    ]
    images = {"camera": batch.image, "lidar": batch.lidar}
    own = [
        torch.stack(
            aligned_loss(
                reading,
                batch.targets,
                assigned[0],
                aligned,
                image_weights=(images[sensor].amax(dim=(1, 2, 3)) > 0).float(),
            )
        ).sum()
        for sensor, reading in readings.auxiliary.items()
    ]
    if not own:
        return terms, terms[0].boxes.new_zeros(())
    return terms, config.auxiliary_weight * torch.stack(own).sum()

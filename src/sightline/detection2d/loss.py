"""What a detector's readings cost."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from sightline.detection2d.readings import Readings
from sightline.detection2d.ssd_loss import SsdLossConfig, multibox_loss
from sightline.detection2d.targets import DetectionTargets


@dataclass(frozen=True, kw_only=True)
class DetectionLossConfig:
    """What training lowers."""

    ssd: SsdLossConfig = SsdLossConfig()  # noqa: RUF009 - frozen
    """Of networks with SSD's heads."""


class DetectionLosses(NamedTuple):
    """The loss and the terms that add up to it."""

    total: Float[Tensor, ""]
    classification: Float[Tensor, ""]
    boxes: Float[Tensor, ""]


def detection_loss(
    readings: Readings, targets: Sequence[DetectionTargets], config: DetectionLossConfig
) -> DetectionLosses:
    """The loss of all heads: of late fusion, each detector has to find everything."""
    found = [multibox_loss(reading, targets, config.ssd) for reading in readings.heads]
    classification = torch.stack([each.classification for each in found]).sum()
    boxes = torch.stack([each.boxes for each in found]).sum()
    return DetectionLosses(total=classification + boxes, classification=classification, boxes=boxes)

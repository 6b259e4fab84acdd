"""Training loss of a 2D detector; health maps of the sensors as targets of its gates."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Float32
from torch import Tensor

from sightline.detection2d.compact.loss import (
    AlignedLossConfig,
    AlignedLosses,
    aligned_loss,
    assign_batch,
)
from sightline.detection2d.dgfn.loss import SsdLossConfig, multibox_loss
from sightline.detection2d.fusion import GateOutput, RawOutputs
from sightline.detection2d.placement import padded
from sightline.detection2d.targets import DetectionBatch
from sightline.geometry.ranges import check_range

CELL_PX: Final = 8
"""Side of the health map's cells: the stride of the finest maps."""


def health(
    broken: Bool[Tensor, "height width"], size: tuple[int, int], *, nothing_left: bool
) -> Float32[Tensor, "1 rows columns"]:
    """Share of each cell's pixels within the image that a sensor still delivers.

    The share is NaN (unknown) beyond the image, and in cells that are fully broken but not gone:
    the gate has to learn by itself how much is left.

    Args:
        broken: Mask of the broken pixels of the sensor's image.
        size: Height, width [px] of the padded image.
        nothing_left: Whether broken pixels contain nothing of the scene.
    """
    is_sound = ~broken
    is_known = torch.ones_like(broken) if nothing_left else is_sound
    sound, known = (
        F.avg_pool2d(padded(each[None].float(), size), CELL_PX, ceil_mode=True)
        for each in (is_sound, is_known)
    )
    return torch.where(known > 0, sound / known.clamp(min=1e-6), torch.nan)


def known_by_points(
    cell_health: Float32[Tensor, "1 rows columns"], lidar: Float32[Tensor, "3 height width"]
) -> Float32[Tensor, "1 rows columns"]:
    """Set a LiDAR's health to unknown in cells without points, which look the same if it fails.

    Args:
        cell_health: Health.
        lidar: The intact LiDAR's image.
    """
    has_point = F.max_pool2d((lidar > 0).float(), CELL_PX, ceil_mode=True).amax(0, keepdim=True)
    return cell_health.where(has_point > 0, torch.nan)


def pooled_health(
    health: Float[Tensor, "batch 1 rows columns"], rows: int, columns: int
) -> Float[Tensor, "batch 1 new_rows new_columns"]:
    """Pool health to a coarser map: the mean of known cells, NaN if there are none."""
    is_known = (~health.isnan()).to(health.dtype)
    size = (rows, columns)
    share = F.adaptive_avg_pool2d(health.nan_to_num(), size)
    known = F.adaptive_avg_pool2d(is_known, size)
    return torch.where(known > 0, share / known.clamp(min=1e-6), torch.nan)


def gate_loss(
    gates: Sequence[GateOutput],
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
    target = pooled_health(health, rows, columns).expand_as(logits)
    is_known = ~target.isnan()
    entropy = F.binary_cross_entropy_with_logits(
        logits.float(), target.nan_to_num(), reduction="none"
    )
    return (entropy * is_known).sum() / is_known.sum().clamp(min=1)


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
        """Check the ranges."""
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
    outputs: RawOutputs, batch: DetectionBatch, config: DetectionLossConfig, *, compact: bool
) -> DetectionLosses:
    """Compute the loss of all heads; in late fusion, each detector has to find all objects.

    A stream's own head has the joint head's targets at the same places, and no loss if its sensor
    is missing.

    Raises:
        ValueError: The gate loss needs health maps that the examples lack.
    """
    nothing = outputs.heads[0].class_logits.new_zeros(())
    auxiliary = nothing
    if compact:
        terms, auxiliary = _compact_terms(outputs, batch, config)
    else:
        found = [multibox_loss(output, batch.targets, config.ssd) for output in outputs.heads]
        terms = [AlignedLosses(each.classification, each.boxes, nothing) for each in found]
    gates = nothing
    if config.gate_weight and outputs.gates:
        if batch.camera_health is None or batch.lidar_health is None:
            raise ValueError(
                "the gate loss (gate_weight above 0) needs health maps, which the examples lack; "
                "set health to true in the examples' settings, or gate_weight to 0"
            )
        gates = config.gate_weight * gate_loss(
            outputs.gates, batch.camera_health, batch.lidar_health
        )
    sums = [torch.stack(list(each)).sum() for each in zip(*terms, strict=True)]
    total = torch.stack([*sums, auxiliary, gates]).sum()
    return DetectionLosses(total, sums[0], sums[1], sums[2], auxiliary, gates)


def _compact_terms(
    outputs: RawOutputs, batch: DetectionBatch, config: DetectionLossConfig
) -> tuple[list[AlignedLosses], Float[Tensor, ""]]:
    """Compute the losses of each head, and of all auxiliary heads together."""
    aligned = config.aligned
    assigned = [assign_batch(output, batch.targets, aligned.assignment) for output in outputs.heads]
    terms = [
        aligned_loss(output, batch.targets, assignments, aligned)
        for output, assignments in zip(outputs.heads, assigned, strict=True)
    ]
    images = {"camera": batch.image, "lidar": batch.lidar}
    own = [
        torch.stack(
            aligned_loss(
                output,
                batch.targets,
                assigned[0],
                aligned,
                image_weights=(images[sensor].amax(dim=(1, 2, 3)) > 0).float(),
            )
        ).sum()
        for sensor, output in outputs.auxiliary.items()
    ]
    if not own:
        return terms, terms[0].boxes.new_zeros(())
    return terms, config.auxiliary_weight * torch.stack(own).sum()

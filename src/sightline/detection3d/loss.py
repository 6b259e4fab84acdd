"""Training losses of detectors: for the first stage, the second, or both."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn

from sightline.detection3d.batch import Detection3DBatch, FirstStageRecord
from sightline.detection3d.loss_config import Detection3DLossConfig
from sightline.detection3d.model import Detector3D
from sightline.detection3d.stages import (
    Proposed,
    Regions,
    SecondStage,
    Sweep,
    autocast_disabled,
)
from sightline.structures.batch import Losses

Stages = Literal["both", "first", "second"]
"""Stages to train: both at once, or one alone."""


@dataclass(frozen=True, slots=True)
class StageLosses:
    """Total training loss, and each stage's terms by name."""

    total: Float[Tensor, ""]
    terms: Mapping[str, Tensor]

    def _asdict(self) -> dict[str, Tensor]:
        return {"total": self.total, **self.terms}


def detection_losses(
    detector: Detector3D, batch: Detection3DBatch, config: Detection3DLossConfig, stages: Stages
) -> StageLosses:
    """Compute the losses of a batch; sweeps without points in range are left out.

    Args:
        detector: Detector with the trained stages in training mode.
        batch: Sweeps. Their records, if any, replace the first stage's work.
        config: Settings of the losses.
        stages: Stages to train.
    """
    used = [number for number, points in enumerate(batch.points) if len(points)]
    sweeps = [batch.points[number] for number in used]
    truths = [batch.truths[number] for number in used]
    terms: dict[str, Tensor] = {}
    total = _nothing(detector)
    proposed: list[Proposed] = []
    if used and batch.records is not None and stages == "second":
        proposed = [proposed_by(batch.records[number], batch.points[number]) for number in used]
    elif used:
        first = detector.first
        with torch.set_grad_enabled(stages != "second"):
            output = first(**first.inputs(sweeps))
        with autocast_disabled(sweeps[0]):
            if stages != "second":
                lost = first.losses(output, sweeps, truths, config)
                terms |= {f"first/{name}": value for name, value in lost._asdict().items()}
                total = total + config.first_weight * lost.total
            if stages != "first" and detector.second is not None:
                proposed = list(first.propose(output, sweeps, training=True))
    second = detector.second
    if proposed and second is not None:
        seeds = [batch.seeds[number] for number in used]
        with autocast_disabled(sweeps[0]):
            examples = [
                second.examples(sweep, proposals, truth, config, seed=seed)
                for sweep, proposals, truth, seed in zip(
                    sweeps, proposed, truths, seeds, strict=True
                )
            ]
        refined = _second_losses(second, examples, config)
        if refined is not None:
            terms |= {f"second/{name}": value for name, value in refined._asdict().items()}
            total = total + refined.total
    return StageLosses(total, terms)


def _nothing(module: nn.Module) -> Float[Tensor, ""]:
    """Zero loss with zero gradients for all trained parameters."""
    return sum(
        (each.sum() * 0.0 for each in module.parameters() if each.requires_grad),
        start=torch.zeros((), device=next(module.parameters()).device),
    )


def proposed_by(record: FirstStageRecord, points: Sweep) -> Proposed:
    """Proposals of a sweep from its saved record."""
    features = record.features.to(points.dtype) if record.features.shape[1] else None
    return Proposed(record.boxes, record.classes, record.scores, features)


def _second_losses(
    second: SecondStage,
    examples: Sequence[tuple[Regions, tuple[Tensor, ...]]],
    config: Detection3DLossConfig,
) -> Losses | None:
    """Loss over the regions of all sweeps together; None if there are no regions."""
    held = [(regions, wanted) for regions, wanted in examples if len(regions.places)]
    if not held:
        return None
    all_regions, all_wanted = zip(*held, strict=True)
    places, boxes, scores = (
        torch.cat([each[column] for each in all_regions]) for column in range(3)
    )
    inputs = {
        name: torch.cat([each.inputs[name] for each in all_regions])
        for name in all_regions[0].inputs
    }
    wanted = type(all_wanted[0])(*(torch.cat(values) for values in zip(*all_wanted, strict=True)))
    output = second(**inputs)
    with autocast_disabled(boxes):
        return second.losses(output, Regions(places, boxes, scores, inputs), wanted, config)

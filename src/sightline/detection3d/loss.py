"""What detectors are trained to lower: the first stage, the second, or both together."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from sightline.detection3d.batch import Detection3DBatch, FirstStageRecord
from sightline.detection3d.loss_config import Detection3DLossConfig
from sightline.detection3d.model import Detector3D
from sightline.detection3d.proposal_sampling import ProposalSamples, sample_proposals
from sightline.detection3d.stages import Proposed, Regions, SecondStage, Sweep
from sightline.detection3d.targets import SweepTruth
from sightline.ops.rotated_iou import pairwise_iou_3d
from sightline.training.module import Losses

Stages = Literal["both", "first", "second"]
"""Which stages are trained: both at once, or one alone."""


@dataclass(frozen=True, slots=True)
class StageLosses:
    """What training lowers, and the stages' terms by name."""

    total: Float[Tensor, ""]
    terms: Mapping[str, Tensor]

    def _asdict(self) -> dict[str, Tensor]:
        return {"total": self.total, **self.terms}


def detection_losses(
    detector: Detector3D, batch: Detection3DBatch, config: Detection3DLossConfig, stages: Stages
) -> StageLosses:
    """The losses of a batch; sweeps without a point that is seen are left out.

    Args:
        detector: In training mode as far as it is trained.
        batch: Of sweeps. Their records, where there are any, stand for the first stage's work.
        config: Of the losses.
        stages: Which are trained.
    """
    used = [number for number, points in enumerate(batch.points) if len(points)]
    terms: dict[str, Tensor] = {}
    total = _nothing(detector)
    proposed: list[Proposed] = []
    if used and batch.records is not None and stages == "second":
        proposed = [proposed_by(batch.records[number], batch.points[number]) for number in used]
    elif used:
        sweeps = [batch.points[number] for number in used]
        first = detector.first
        with torch.set_grad_enabled(stages != "second"):
            output = first(**first.inputs(sweeps))
        if stages != "second":
            lost = first.losses(output, sweeps, [batch.truths[each] for each in used], config)
            terms |= {f"first/{name}": value for name, value in lost._asdict().items()}
            total = total + config.first_weight * lost.total
        if stages != "first" and detector.second is not None:
            proposed = list(first.propose(output, sweeps, detector.config.training_proposals))
    second = detector.second
    if proposed and second is not None:
        examples = [
            _examples(second, batch.points[number], proposals, batch.truths[number],
                      config, batch.seeds[number])
            for number, proposals in zip(used, proposed, strict=True)
        ]  # fmt: skip
        refined = _second_losses(second, examples, config)
        if refined is not None:
            terms |= {f"second/{name}": value for name, value in refined._asdict().items()}
            total = total + refined.total
    return StageLosses(total, terms)


def _nothing(module: nn.Module) -> Float[Tensor, ""]:
    """A loss of 0 whose gradient is 0 for all that is trained."""
    return sum(
        (each.sum() * 0.0 for each in module.parameters() if each.requires_grad),
        start=torch.zeros((), device=next(module.parameters()).device),
    )


def proposed_by(record: FirstStageRecord, points: Sweep) -> Proposed:
    """What a first stage gave for a sweep's points when its record was made."""
    features = record.features.to(points.dtype)
    return Proposed(record.boxes, record.classes, record.scores, features)


def _examples(
    second: SecondStage,
    sweep: Sweep,
    proposed: Proposed,
    truth: SweepTruth,
    config: Detection3DLossConfig,
    seed: int,
) -> tuple[Regions, ProposalSamples]:
    """Regions of a sweep to train on, and what each is to become."""
    boxes = proposed.boxes[(proposed.boxes[:, 3:6] > 0).all(dim=1)]
    boxes = boxes[~_is_on_ignored(boxes, truth, config)]
    generator = torch.Generator().manual_seed(seed)
    wanted = truth.boxes[truth.is_wanted]
    samples = sample_proposals(boxes, wanted, config.sampling, generator=generator)
    regions = second.regions(sweep, proposed.features, boxes[samples.proposal], seed=seed)
    return regions, ProposalSamples(*(values[regions.places] for values in samples))


def _is_on_ignored(
    boxes: Float[Tensor, "num_proposals 7"], truth: SweepTruth, config: Detection3DLossConfig
) -> Bool[Tensor, " num_proposals"]:
    """Which proposals would be hard to call background: they are on an ignored object."""
    ignored = truth.boxes[~truth.is_wanted]
    if not len(ignored) or not len(boxes):
        return torch.zeros(len(boxes), dtype=torch.bool, device=boxes.device)
    most = pairwise_iou_3d(boxes.double(), ignored).amax(dim=1)
    wanted = truth.boxes[truth.is_wanted]
    own = torch.zeros_like(most)
    if len(wanted):
        own = pairwise_iou_3d(boxes.double(), wanted).amax(dim=1)
    return (most >= config.sampling.background_iou) & (most > own)


def _second_losses(
    second: SecondStage,
    examples: Sequence[tuple[Regions, ProposalSamples]],
    config: Detection3DLossConfig,
) -> Losses | None:
    """Of the regions of all sweeps together; None where there is none."""
    held = [(regions, samples) for regions, samples in examples if len(regions.places)]
    if not held:
        return None
    all_regions, all_samples = zip(*held, strict=True)
    regions = Regions(
        torch.cat([each.places for each in all_regions]),
        torch.cat([each.boxes for each in all_regions]),
        {
            name: torch.cat([each.inputs[name] for each in all_regions])
            for name in all_regions[0].inputs
        },
    )
    samples = ProposalSamples(*(torch.cat(values) for values in zip(*all_samples, strict=True)))
    return second.losses(second(**regions.inputs), regions, samples, config)

"""Training losses of detectors, and the recall of their first stages."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torchmetrics import Metric

from sightline.detection3d.config import Detection3DLossConfig
from sightline.detection3d.detector import POINT_SEED, Detector3D
from sightline.detection3d.examples import Detection3DBatch
from sightline.detection3d.points.refinement import PointRefinement
from sightline.detection3d.stages import Proposed, Regions, SecondStage, autocast_disabled
from sightline.ops.rotated_iou import pairwise_iou_3d
from sightline.structures.batch import Losses

_IOUS: Final = (0.5, 0.7)

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

    The batch's records, if any, replace the first stage's work.
    """
    used = [number for number, points in enumerate(batch.points) if len(points)]
    sweeps = [batch.points[number] for number in used]
    truths = [batch.truths[number] for number in used]
    terms: dict[str, Tensor] = {}
    total = sum(  # 0, with gradients of 0 for all trained parameters
        (each.sum() * 0.0 for each in detector.parameters() if each.requires_grad),
        start=torch.zeros((), device=next(detector.parameters()).device),
    )
    proposed: list[Proposed] = []
    if used and batch.records is not None and stages == "second":
        proposed = [batch.records[number].proposed for number in used]
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
        rows = zip(sweeps, proposed, truths, seeds, strict=True)
        with autocast_disabled(sweeps[0]):
            examples = [
                second.examples(sweep, proposals, truth, config, seed=seed)
                for sweep, proposals, truth, seed in rows
            ]
        refined = _second_losses(second, examples, config)
        if refined is not None:
            terms |= {f"second/{name}": value for name, value in refined._asdict().items()}
            total = total + refined.total
    return StageLosses(total, terms)


def _second_losses(
    second: SecondStage,
    examples: Sequence[tuple[Regions, tuple[Tensor, ...]]],
    config: Detection3DLossConfig,
) -> Losses | None:
    """Loss over the regions of all sweeps together; None if there are no regions."""
    held = [(regions, targets) for regions, targets in examples if len(regions.places)]
    if not held:
        return None
    all_regions, all_targets = zip(*held, strict=True)
    places, boxes, scores = (
        torch.cat([each[column] for each in all_regions]) for column in range(3)
    )
    inputs = {
        name: torch.cat([each.inputs[name] for each in all_regions])
        for name in all_regions[0].inputs
    }
    targets = type(all_targets[0])(
        *(torch.cat(values) for values in zip(*all_targets, strict=True))
    )
    output = second(**inputs)
    with autocast_disabled(boxes):
        return second.losses(output, Regions(places, boxes, scores, inputs), targets, config)


def validation_losses(
    detector: Detector3D,
    batch: Detection3DBatch,
    proposed: Sequence[Proposed],
    config: Detection3DLossConfig,
) -> Losses | None:
    """Compute the plain second stage's losses over all proposals of a batch.

    Each proposal has the object of highest IoU as its target, without sampling. None without such a
    stage, or without proposals.
    """
    second = detector.second
    if not isinstance(second, PointRefinement):
        return None
    rows = zip(batch.points, proposed, batch.truths, strict=True)
    examples = [
        second.all_examples(sweep, proposals, truth, seed=POINT_SEED)
        for sweep, proposals, truth in rows
        if len(sweep)
    ]
    return _second_losses(second, examples, config)


def find_recalled(
    proposals: Float[Tensor, "num_proposals 7"],
    truths: Float[Tensor, "num_truths 7"],
    *,
    min_iou: float = 0.5,
) -> Bool[Tensor, " num_truths"]:
    """Mask of the objects that a proposal overlaps by at least `min_iou` in 3D.

    One proposal may match several objects. Boxes are x, y, z, length, width, height, yaw (LiDAR
    frame, metres, radians); boxes without volume overlap nothing.

    Raises:
        ValueError: A box is not finite or has a negative size, or `min_iou` is not above 0 and up
            to 1.
    """
    if not 0 < min_iou <= 1:
        raise ValueError(f"min_iou must be above 0 and at most 1, got {min_iou}")
    if proposals.shape[0] == 0:
        return torch.zeros_like(truths[:, 0], dtype=torch.bool)
    return pairwise_iou_3d(proposals.double(), truths).amax(dim=0) >= min_iou


class ProposalRecallMetric(Metric):
    """Recall of all target objects of any difficulty, in percent.

    KITTI's difficulties need result files: `sightline evaluate proposals`.
    """

    is_differentiable = False
    higher_is_better = True
    full_state_update = False

    num_found: Tensor
    """Number of recalled objects for each IoU."""
    num_truths: Tensor
    recalls: Tensor
    """Sum of the frames' recalls for each IoU; a frame without objects counts 0."""
    num_frames: Tensor

    def __init__(self) -> None:
        """Start without frames."""
        super().__init__()
        for name, size in (("num_found", 2), ("num_truths", 1), ("recalls", 2), ("num_frames", 1)):
            self.add_state(name, torch.zeros(size, dtype=torch.float64), dist_reduce_fx="sum")

    def update(
        self, proposals: Sequence[Float[Tensor, "_ 7"]], truths: Sequence[Float[Tensor, "_ 7"]]
    ) -> None:
        """Add frames: boxes x, y, z, length, width, height, yaw of each."""
        for proposed, truth in zip(proposals, truths, strict=True):
            counts = [find_recalled(proposed, truth, min_iou=iou).sum() for iou in _IOUS]
            found = torch.stack(counts).to(self.num_found)
            self.num_found += found
            self.num_truths += len(truth)
            self.recalls += found / max(len(truth), 1)
            self.num_frames += 1

    def compute(self) -> dict[str, Tensor]:
        """Compute recall/0.5 and the like, and their means over frames: recall/0.5_frames."""
        scores: dict[str, Tensor] = {}
        for column, iou in enumerate(_IOUS):
            object_recall = self.num_found[column] / self.num_truths[0].clamp(min=1)
            frame_recall = self.recalls[column] / self.num_frames[0].clamp(min=1)
            scores |= {
                f"recall/{iou}": 100 * object_recall,
                f"recall/{iou}_frames": 100 * frame_recall,
            }
        return scores

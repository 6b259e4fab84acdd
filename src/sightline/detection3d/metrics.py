"""Recall of a first stage's proposals, as a metric of a training run."""

from collections.abc import Sequence
from typing import Final

import torch
from jaxtyping import Float
from torch import Tensor
from torchmetrics import Metric

from sightline.detection3d.proposal_recall import find_recalled

_IOUS: Final = (0.5, 0.7)


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
        for proposed, wanted in zip(proposals, truths, strict=True):
            counts = [find_recalled(proposed, wanted, min_iou=iou).sum() for iou in _IOUS]
            found = torch.stack(counts).to(self.num_found)
            self.num_found += found
            self.num_truths += len(wanted)
            self.recalls += found / max(len(wanted), 1)
            self.num_frames += 1

    def compute(self) -> dict[str, Tensor]:
        """Compute recall/0.5 and the like, and their means over frames: recall/0.5_frames."""
        scores: dict[str, Tensor] = {}
        for column, iou in enumerate(_IOUS):
            of_objects = self.num_found[column] / self.num_truths[0].clamp(min=1)
            of_frames = self.recalls[column] / self.num_frames[0].clamp(min=1)
            scores |= {f"recall/{iou}": 100 * of_objects, f"recall/{iou}_frames": 100 * of_frames}
        return scores

"""Recall of labelled objects by the first stage's proposals, during training.

`sightline.evaluation.kitti_object_proposals` scores result files by KITTI's difficulties.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from sightline.ops.rotated_iou import pairwise_iou_3d


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


@dataclass(frozen=True, kw_only=True, slots=True)
class ProposalRecall:
    """Recall over frames, each from 0 to 1; 0 where nothing is counted."""

    num_found: tuple[int, ...]
    """Number of recalled objects in each frame."""
    num_truths: tuple[int, ...]
    """Number of objects in each frame."""

    def __post_init__(self) -> None:
        """Checks that the counts match."""
        pairs = tuple(zip(self.num_found, self.num_truths, strict=True))
        if any(not 0 <= found <= truths for found, truths in pairs):
            raise ValueError(f"a frame cannot have more objects found than objects, got {pairs}")

    @property
    def recall(self) -> float:
        """Recalled objects over all objects."""
        return sum(self.num_found) / max(sum(self.num_truths), 1)

    @property
    def recall_frames_with_objects(self) -> float:
        """Mean of the frames' recalls, over the frames that have objects."""
        return self._total / max(sum(truths > 0 for truths in self.num_truths), 1)

    @property
    def recall_all_frames(self) -> float:
        """Mean of the frames' recalls over all frames; a frame without objects counts 0."""
        return self._total / max(len(self.num_truths), 1)

    @property
    def _total(self) -> float:
        """Sum of the frames' recalls."""
        counts = zip(self.num_found, self.num_truths, strict=True)
        return sum((found / max(truths, 1) for found, truths in counts), start=0.0)

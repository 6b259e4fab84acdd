"""Selection of proposals for the second stage among the points' boxes."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from sightline.geometry.boxes3d import Boxes3D
from sightline.ops.nms import nms_bev

_MOST_PAIRS = 2**25  # pairs of boxes for the IoU, which takes a few seconds


@dataclass(frozen=True, kw_only=True)
class ProposalConfig:
    """Settings for proposals: Shi et al. 2019 (PointRCNN), section 3.1, at test time."""

    num_proposals: int = 100
    """Largest number of proposals for a sweep."""
    num_candidates: int = 9000
    """Number of boxes with the highest scores that are considered."""
    iou: float = 0.8
    """IoU from above beyond which a box with a lower score is removed."""
    near_m: float = 40.0
    """Largest distance from the sensor of a near box."""
    near_share: float = 0.7
    """Share of near boxes among candidates and proposals: far cars have few points, and near ones
    would otherwise crowd them out."""

    def __post_init__(self) -> None:
        """Checks the numbers."""
        if not 1 <= self.num_proposals <= self.num_candidates:
            raise ValueError(
                f"num_proposals must be from 1 to num_candidates {self.num_candidates}, got "
                f"{self.num_proposals}"
            )
        if self.num_proposals * self.num_candidates > _MOST_PAIRS:
            raise ValueError(
                f"num_proposals times num_candidates must be up to {_MOST_PAIRS}, got "
                f"{self.num_proposals} times {self.num_candidates}"
            )
        if not 0 <= self.iou <= 1:
            raise ValueError(f"iou must be from 0 to 1, got {self.iou}")
        if not 0 < self.near_m < math.inf:
            raise ValueError(f"near_m must be positive and finite, got {self.near_m}")
        if not 0 <= self.near_share <= 1:
            raise ValueError(f"near_share must be from 0 to 1, got {self.near_share}")


TRAINING_PROPOSALS = ProposalConfig(num_proposals=512, iou=0.85)
"""Settings of the published code for the second stage's training; the paper keeps 300."""


def choose_proposals(
    boxes: Float[Tensor, "num_boxes 7"],
    scores: Float[Tensor, " num_boxes"],
    config: ProposalConfig = ProposalConfig(),
) -> Int64[Tensor, " num_proposals"]:
    """Select proposals: indices of the near boxes by descending score, then of the far ones.

    Near and far boxes are each limited to their share of candidates by score, then thinned by
    non-maximum suppression from above, then limited to their share of proposals. If there are no
    far boxes, or no near ones, the other group takes both shares.

    Departure: distance is measured over the ground from the sensor, not along its axis, and has no
    limit.

    Args:
        boxes: x, y, z, length, width, height, yaw (LiDAR frame, metres, radians).
        scores: Score of each box.
        config: Numbers.

    Raises:
        ValueError: A score is NaN, or a box is not finite or has a negative size.
    """
    is_near = torch.hypot(boxes[:, 0], boxes[:, 1]) <= config.near_m
    near, far = is_near.nonzero()[:, 0], (~is_near).nonzero()[:, 0]
    shares = [(config.num_candidates, config.num_proposals), (0, 0)]
    if len(near) and len(far):
        candidates = round(config.near_share * config.num_candidates)
        proposals = round(config.near_share * config.num_proposals)
        far_share = (config.num_candidates - candidates, config.num_proposals - proposals)
        shares = [(candidates, proposals), far_share]
    elif len(far):
        shares.reverse()
    chosen = []
    for places, (num_candidates, num_proposals) in zip((near, far), shares, strict=True):
        order = scores[places].argsort(descending=True, stable=True)[:num_candidates]
        best = places[order]
        kept = nms_bev(
            Boxes3D(boxes[best]).bev, scores[best], config.iou, max_detections=num_proposals
        )
        chosen.append(best[kept])
    return torch.cat(chosen)

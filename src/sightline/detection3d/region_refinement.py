"""Proposals refined by the compact second stage, once or several times by the same network."""

from dataclasses import dataclass, field

import torch
from jaxtyping import Float
from torch import Tensor

from sightline.detection3d.pillar_detections import FoundBoxes
from sightline.detection3d.region_coding import decode_regions
from sightline.detection3d.region_config import RegionConfig
from sightline.detection3d.region_network import RegionNetwork
from sightline.detection3d.regions import cut_regions
from sightline.detection3d.suppression import SuppressionConfig, suppress_boxes


@dataclass(frozen=True, kw_only=True)
class RegionRefinementConfig:
    """How often proposals are refined, and what is answered."""

    passes: int = 2
    """The points of each pass are those around the boxes of the one before."""
    quality_share: float = 0.5
    """Share of the last quality in the score, a product of powers; the proposal has the rest."""
    suppression: SuppressionConfig = field(
        default_factory=lambda: SuppressionConfig(min_score=0.05)
    )
    """Which refined boxes stay, of each class."""
    seed: int = 0
    """Of the points that are drawn where a region has too many."""

    def __post_init__(self) -> None:
        """Checks the numbers."""
        if self.passes < 1:
            raise ValueError(f"passes must be at least 1, got {self.passes}")
        if not 0 <= self.quality_share <= 1:
            raise ValueError(f"quality_share must be from 0 to 1, got {self.quality_share}")


@torch.no_grad()
def refine_boxes(
    network: RegionNetwork,
    points: Float[Tensor, "num_points 3"],
    features: Float[Tensor, "num_points in_channels"],
    proposals: FoundBoxes,
    regions: RegionConfig,
    config: RegionRefinementConfig = RegionRefinementConfig(),
) -> FoundBoxes:
    """The proposals of a sweep as the second stage changes them, best first.

    Args:
        network: In evaluation mode or not, which makes no difference to it.
        points: LiDAR frame [m].
        features: Of the points, as the network was trained with.
        proposals: Of the first stage; none give none.
        regions: The network's settings.
        config: Passes, score and suppression.

    Raises:
        ValueError: A coordinate or a box is not finite.
    """
    boxes, quality = proposals.boxes, proposals.scores
    for _ in range(config.passes):
        cut = cut_regions(points, features, boxes, proposals.classes, regions, seed=config.seed)
        output = network(*cut)
        boxes = decode_regions(output.values, output.front_logits >= 0, boxes)
        quality = output.quality_logits.sigmoid()
    share = config.quality_share
    scores = proposals.scores ** (1 - share) * quality**share
    kept = suppress_boxes(boxes, scores, config.suppression, labels=proposals.classes)
    return FoundBoxes(boxes[kept], proposals.classes[kept], scores[kept])

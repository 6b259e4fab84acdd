"""The plain second stage: boxes as they are, from the points in and around each proposal."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from sightline.detection3d.config import RefinementConfig
from sightline.detection3d.loss_config import Detection3DLossConfig
from sightline.detection3d.proposal_sampling import ProposalSamples
from sightline.detection3d.refinement_loss import box_loss, confidence_loss
from sightline.detection3d.refinement_network import RefinementNetwork, RefinementOutput
from sightline.detection3d.roi_pooling import RoiPoolingConfig, pool_rois
from sightline.detection3d.stages import Refined, Regions, Sweep
from sightline.geometry.transforms import wrap_angle

_LEAST_SIZE_M = 0.01


class PointRefinementLosses(NamedTuple):
    """Scalars."""

    total: Float[Tensor, ""]
    """boxes + confidence."""
    boxes: Float[Tensor, ""]
    confidence: Float[Tensor, ""]


class PointRefinement(nn.Module):
    """A `SecondStage`: `RefinementNetwork` on what `pool_rois` draws."""

    output_type = RefinementOutput
    passes = 1

    def __init__(self, config: RefinementConfig, pooling: RoiPoolingConfig) -> None:
        super().__init__()
        self.pooling = pooling
        self.network = RefinementNetwork(config)

    def forward(
        self,
        points: Float[Tensor, "num_rois roi_points 3"],
        features: Float[Tensor, "num_rois roi_points channels"],
        **found: Tensor,
    ) -> RefinementOutput:
        """Of the points of regions and their neighbourhoods."""
        output: RefinementOutput = self.network(points, features, found)
        return output

    def regions(
        self,
        sweep: Sweep,
        features: Float[Tensor, "num_points channels"] | None,
        boxes: Float[Tensor, "num_proposals 7"],
        *,
        seed: int,
    ) -> Regions:
        """Draws points around proposals; differentiable by the features."""
        assert features is not None, "settings name a first stage that gives features"
        drawn = pool_rois(sweep[:, :3].contiguous(), features, boxes, self.pooling, seed=seed)
        given = {"points": drawn.points, "features": drawn.features}
        if len(drawn.points):
            given |= self.network.find(drawn.points)
        return Regions(drawn.proposal, drawn.boxes, given)

    def refine(self, output: RefinementOutput, regions: Regions) -> Refined:
        """The boxes as given; sizes that an untrained network makes negative are a centimetre."""
        del regions
        boxes = output.boxes.float()
        told = (boxes[:, :3], boxes[:, 3:6].clamp(min=_LEAST_SIZE_M), wrap_angle(boxes[:, 6:]))
        return Refined(torch.cat(told, dim=1), output.logits.float().sigmoid())

    def losses(
        self,
        output: RefinementOutput,
        regions: Regions,
        samples: ProposalSamples,
        config: Detection3DLossConfig,
    ) -> PointRefinementLosses:
        """See `box_loss` and `confidence_loss`."""
        del regions
        boxes = box_loss(output.boxes.float(), samples.boxes, samples.iou, config.refinement).total
        confidence = confidence_loss(output.logits.float(), samples.iou, config.refinement)
        return PointRefinementLosses(boxes + confidence, boxes, confidence)

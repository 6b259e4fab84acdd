"""Plain second stage: boxes in absolute values, from the points in and around each proposal."""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from sightline.detection3d.config import RefinementConfig
from sightline.detection3d.loss_config import Detection3DLossConfig
from sightline.detection3d.proposal_sampling import (
    ProposalSamples,
    ProposalSamplingConfig,
    sample_proposals,
)
from sightline.detection3d.refinement_loss import box_loss, confidence_loss
from sightline.detection3d.refinement_network import RefinementNetwork, RefinementOutput
from sightline.detection3d.roi_pooling import RoiPoolingConfig, pool_rois
from sightline.detection3d.stages import Proposed, Refined, Regions, Sweep
from sightline.detection3d.targets import SweepTruth
from sightline.detection3d.views import AS_IT_IS
from sightline.geometry.transforms import wrap_angle
from sightline.ops.rotated_iou import pairwise_iou_3d

_LEAST_SIZE_M = 0.01


class PointRefinementLosses(NamedTuple):
    """Scalar losses."""

    total: Float[Tensor, ""]
    """boxes + confidence."""
    boxes: Float[Tensor, ""]
    confidence: Float[Tensor, ""]


class PointRefinement(nn.Module):
    """`SecondStage`: `RefinementNetwork` on the output of `pool_rois`."""

    output_type = RefinementOutput
    views = (AS_IT_IS,)
    passes = 1
    mean_with_first = ()

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
        """Run the network on the points of regions and their neighbourhoods."""
        output: RefinementOutput = self.network(points, features, found)
        return output

    def regions(
        self,
        sweep: Sweep,
        proposed: Proposed,
        *,
        seed: int,
    ) -> Regions:
        """Draw points around proposals; differentiable with respect to the features."""
        features = sweep[:, :0] if proposed.features is None else proposed.features
        points = sweep[:, :3].contiguous()
        drawn = pool_rois(points, features, proposed.boxes, self.pooling, seed=seed)
        given = {"points": drawn.points, "features": drawn.features}
        if len(drawn.points):
            given |= self.network.find(drawn.points)
        scores = proposed.scores[drawn.proposal]
        return Regions(drawn.proposal, drawn.boxes, scores, given)

    def examples(
        self,
        sweep: Sweep,
        proposed: Proposed,
        truth: SweepTruth,
        config: Detection3DLossConfig,
        *,
        seed: int,
    ) -> tuple[Regions, ProposalSamples]:
        """Sample proposals with `sample_proposals`, without those on ignored objects."""
        usable = (proposed.boxes[:, 3:6] > 0).all(dim=1)
        usable[usable.clone()] = ~_is_on_ignored(proposed.boxes[usable], truth, config.sampling)
        boxes, classes, scores = (values[usable] for values in proposed[:3])
        generator = torch.Generator().manual_seed(seed)
        samples = sample_proposals(
            boxes, truth.boxes.to(boxes.dtype), config.sampling, generator=generator
        )
        chosen = samples.proposal
        drawn = Proposed(boxes[chosen], classes[chosen], scores[chosen], proposed.features)
        regions = self.regions(sweep, drawn, seed=seed)
        return regions, ProposalSamples(*(values[regions.places] for values in samples))

    def refine(self, output: RefinementOutput, regions: Regions) -> Refined:
        """Return the predicted boxes, with sizes of at least a centimetre."""
        del regions
        boxes = output.boxes.float()
        told = (boxes[:, :3], boxes[:, 3:6].clamp(min=_LEAST_SIZE_M), wrap_angle(boxes[:, 6:]))
        scores = output.logits.float().sigmoid()
        return Refined(torch.cat(told, dim=1), scores, torch.zeros_like(scores))

    def losses(
        self,
        output: RefinementOutput,
        regions: Regions,
        wanted: ProposalSamples,
        config: Detection3DLossConfig,
    ) -> PointRefinementLosses:
        """Compute `box_loss` and `confidence_loss`."""
        del regions
        boxes = box_loss(output.boxes.float(), wanted.boxes, wanted.iou, config.refinement).total
        confidence = confidence_loss(output.logits.float(), wanted.iou, config.refinement)
        return PointRefinementLosses(boxes + confidence, boxes, confidence)


def _is_on_ignored(
    boxes: Float[Tensor, "num_proposals 7"], truth: SweepTruth, config: ProposalSamplingConfig
) -> Bool[Tensor, " num_proposals"]:
    """Mask of the proposals on an ignored object, which are no clear background."""
    if not len(truth.ignored_boxes) or not len(boxes):
        return torch.zeros(len(boxes), dtype=torch.bool, device=boxes.device)
    most = pairwise_iou_3d(boxes.double(), truth.ignored_boxes).amax(dim=1)
    own = torch.zeros_like(most)
    if len(truth.boxes):
        own = pairwise_iou_3d(boxes.double(), truth.boxes).amax(dim=1)
    return (most >= config.background_iou) & (most > own)

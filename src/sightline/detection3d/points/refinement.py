"""Plain second stage: a box and its confidence from the points around each proposal."""

import math
from typing import NamedTuple, cast

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor, nn

from sightline.detection3d.config import Detection3DLossConfig
from sightline.detection3d.points.config import (
    ProposalSamplingConfig,
    RefinementConfig,
    RoiPoolingConfig,
)
from sightline.detection3d.points.layers import (
    PointFeatures,
    SetAbstraction,
    abstract,
    find_groupings,
    head_layers,
    point_layers,
)
from sightline.detection3d.points.refinement_training import (
    ProposalSamples,
    RefinementLosses,
    assign_truths,
    box_loss,
    confidence_loss,
    sample_proposals,
)
from sightline.detection3d.stages import (
    Proposed,
    Refined,
    Regions,
    SecondStage,
    autocast_disabled,
)
from sightline.detection3d.sweeps import Sweep, SweepTruth
from sightline.geometry.transforms import wrap_angle
from sightline.ops.group_points import group_points
from sightline.ops.roi_points import RoiPoints, roi_points
from sightline.ops.rotated_iou import pairwise_iou_3d

_BOX_VALUES = 7
_MIN_SIZE_M = 0.01
_LAST_LAYER_SCALE = 0.1


class RefinementOutput(NamedTuple):
    """Output of the second stage for each region of interest."""

    boxes: Float[Tensor, "num_rois 7"]
    """x, y, z, length, width, height, yaw in the frame of the points: metres, radians."""
    logits: Float[Tensor, " num_rois"]
    """Confidence before the sigmoid."""


class RefinementNetwork(nn.Module):
    """Set abstractions down to one vector for each region, and two heads.

    After Shi et al. 2019 (PointRCNN), section 3.3, in its plainest form: the points are in the
    frame of the sweep, boxes are regressed in absolute values, the proposal itself is not an input.
    """

    def __init__(self, config: RefinementConfig) -> None:
        super().__init__()
        batch_norm, channels = config.batch_norm, config.in_channels
        self.levels = nn.ModuleList()
        for level in config.levels:
            self.levels.append(SetAbstraction(channels, level, batch_norm=batch_norm))
            channels = level.out_channels
        self.together = point_layers(3 + channels, config.global_widths, batch_norm=batch_norm)
        self.box_head, self.confidence_head = (
            head_layers(config.global_widths[-1], config.head_widths, width, batch_norm=batch_norm)
            for width in (_BOX_VALUES, 1)
        )
        self._start(config)

    def _start(self, config: RefinementConfig) -> None:
        """Draw weights that keep the size of features (He et al. 2015), with `first_box` as output.

        Without batch normalisation, PyTorch's start shrinks them by a factor of 2.4 a layer, so
        that all regions look alike; and first outputs tens of metres off stop most units for good.
        """
        linear = [layer for layer in self.modules() if isinstance(layer, nn.Linear)]
        for layer in linear:
            nn.init.kaiming_normal_(layer.weight, nonlinearity="relu")
            if layer.bias is not None:
                nn.init.zeros_(layer.bias)
        with torch.no_grad():
            for head in (self.box_head, self.confidence_head):
                cast("nn.Linear", head[-1]).weight.mul_(_LAST_LAYER_SCALE)
            cast("nn.Linear", self.box_head[-1]).bias.copy_(torch.tensor(config.first_box))

    def forward(
        self,
        points: Float[Tensor, "num_rois roi_points 3"],
        features: Float[Tensor, "num_rois roi_points channels"],
        **found: Tensor,
    ) -> RefinementOutput:
        """Compute a box and a logit for each region; the number of regions may be 0.

        Args:
            points: Points of the regions [m].
            features: Features of these points.
            found: Output of `find_groupings`.
        """
        places, known = abstract(PointFeatures(points, features), self.levels, found)[-1]
        with autocast_disabled(places):  # bfloat16 has steps of 0.25 m at 40 m
            region = self.together(torch.cat((places, known.to(places.dtype)), dim=2)).amax(dim=1)
            return RefinementOutput(self.box_head(region), self.confidence_head(region)[:, 0])


class PointRefinement(SecondStage):
    """Second stage: `RefinementNetwork` on the points in and around each proposal."""

    output_type = RefinementOutput
    network: RefinementNetwork

    def __init__(self, config: RefinementConfig, pooling: RoiPoolingConfig) -> None:
        super().__init__()
        self.pooling = pooling
        self.network = RefinementNetwork(config)

    def regions(self, sweep: Sweep, proposed: Proposed, *, seed: int) -> Regions:
        """Draw a fixed number of points for each proposal; those without points are dropped.

        From more points a random subset is drawn, reproducible by the seed; of fewer, all are taken
        and some repeated at random (`ops.roi_points`). All-zero proposals are dropped, too.
        Differentiable with respect to the features.

        Raises:
            ValueError: A coordinate or a box is not finite, a size negative or the seed out of
                range.
        """
        drawn = self._draw(sweep, proposed, seed)
        kept = drawn.num_inside[0].nonzero()[:, 0]
        return self._regions(sweep, proposed, drawn, kept)

    def examples(
        self,
        sweep: Sweep,
        proposed: Proposed,
        truth: SweepTruth,
        config: Detection3DLossConfig,
        *,
        seed: int,
    ) -> tuple[Regions, ProposalSamples]:
        """Sample proposals with `sample_proposals`, without those on ignored objects.

        Points are drawn first: proposals without points are no samples.
        """
        drawn = self._draw(sweep, proposed, seed)
        usable = drawn.num_inside[0] > 0
        usable[usable.clone()] = ~_is_on_ignored(proposed.boxes[usable], truth, config.sampling)
        places = usable.nonzero()[:, 0]
        boxes, generator = proposed.boxes[places], torch.Generator().manual_seed(seed)
        samples = sample_proposals(
            boxes, truth.boxes.to(boxes.dtype), config.sampling, generator=generator
        )
        return self._regions(sweep, proposed, drawn, places[samples.proposal]), samples

    def all_examples(
        self, sweep: Sweep, proposed: Proposed, truth: SweepTruth, *, seed: int
    ) -> tuple[Regions, ProposalSamples]:
        """Take every proposal with points once, with the object of highest IoU, to validate."""
        drawn = self._draw(sweep, proposed, seed)
        places = drawn.num_inside[0].nonzero()[:, 0]
        boxes = proposed.boxes[places]
        truths = truth.boxes.to(boxes.dtype)
        assigned = assign_truths(pairwise_iou_3d(boxes.double(), truths.double()), truths)
        samples = ProposalSamples(places, assigned.boxes, assigned.iou)
        return self._regions(sweep, proposed, drawn, places), samples

    def _draw(self, sweep: Sweep, proposed: Proposed, seed: int) -> RoiPoints:
        points, boxes = sweep[None, :, :3].contiguous(), proposed.boxes[None]
        margin_m, count = self.pooling.margin_m, self.pooling.num_points
        return roi_points(points, boxes, margin_m=margin_m, count=count, seed=seed)

    def _regions(
        self, sweep: Sweep, proposed: Proposed, drawn: RoiPoints, places: Int64[Tensor, " num_rois"]
    ) -> Regions:
        """Collect the drawn points of some proposals, and their neighbourhoods."""
        features = sweep[:, :0] if proposed.features is None else proposed.features
        index = drawn.indices[:, places]
        place, known = (group_points(each[None], index)[0] for each in (sweep[:, :3], features))
        given = {"points": place, "features": known}
        if len(places):
            given |= find_groupings(place, self.network.levels, index[0])[0]
        return Regions(places, proposed.boxes[places], proposed.scores[places], given)

    def refine(self, output: RefinementOutput, regions: Regions) -> Refined:
        """Return the predicted boxes, with sizes of at least a centimetre."""
        del regions
        boxes = output.boxes.float()
        columns = (boxes[:, :3], boxes[:, 3:6].clamp(min=_MIN_SIZE_M), wrap_angle(boxes[:, 6:]))
        scores = output.logits.float().sigmoid()
        return Refined(torch.cat(columns, dim=1), scores, torch.zeros_like(scores))

    def losses(
        self,
        output: RefinementOutput,
        regions: Regions,
        targets: ProposalSamples,
        config: Detection3DLossConfig,
    ) -> RefinementLosses:
        """Compute `box_loss`, with yaws in the handout's range, and `confidence_loss`."""
        del regions
        truths = _with_handout_yaws(targets.boxes)
        boxes = box_loss(output.boxes.float(), truths, targets.iou, config.refinement).total
        confidence = confidence_loss(output.logits.float(), targets.iou, config.refinement)
        return RefinementLosses(boxes + confidence, boxes, confidence)


def _with_handout_yaws(boxes: Float[Tensor, "n 7"]) -> Float[Tensor, "n 7"]:
    """Boxes with yaws in [-3/2 pi, pi/2), where the handout's camera rotation is in (-pi, pi].

    The loss compares numbers. In [-pi, pi) oncoming cars lie at both ends, some 2 pi apart; here
    these are cars across the road, which are fewer.
    """
    yaws = wrap_angle(boxes[:, 6:] + math.pi / 2) - math.pi / 2
    return torch.cat((boxes[:, :6], yaws), dim=1)


def _is_on_ignored(
    boxes: Float[Tensor, "num_proposals 7"], truth: SweepTruth, config: ProposalSamplingConfig
) -> Bool[Tensor, " num_proposals"]:
    """Mask of the proposals on an ignored object, which are no clear background."""
    if not len(truth.ignored_boxes) or not len(boxes):
        return torch.zeros(len(boxes), dtype=torch.bool, device=boxes.device)
    ignored_iou = pairwise_iou_3d(boxes.double(), truth.ignored_boxes).amax(dim=1)
    own = torch.zeros_like(ignored_iou)
    if len(truth.boxes):
        own = pairwise_iou_3d(boxes.double(), truth.boxes).amax(dim=1)
    return (ignored_iou >= config.background_iou) & (ignored_iou > own)

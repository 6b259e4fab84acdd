"""First stage on points: a foreground score and a box for each, and the choice of proposals."""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn
from torch.nn.utils.rnn import pad_sequence

from sightline.detection3d.config import Detection3DLossConfig
from sightline.detection3d.points.box_coding import (
    ProposalNetworkOutput,
    decode_boxes,
    likeliest_code,
    split_prediction,
)
from sightline.detection3d.points.config import ProposalConfig, ProposalNetworkConfig
from sightline.detection3d.points.layers import PointBackbone, head_layers
from sightline.detection3d.points.proposal_training import IGNORED, ProposalLosses, proposal_loss
from sightline.detection3d.stages import FirstStage, Proposed
from sightline.detection3d.sweeps import Sweep, SweepTruth
from sightline.geometry.boxes3d import Boxes3D
from sightline.ops.nms import nms_bev

_PRIOR = 0.01  # foreground probability before training: Lin et al. 2017, section 4.1


class ProposalNetwork(nn.Module):
    """Backbone and two heads: Shi et al. 2019 (PointRCNN), section 3.1."""

    def __init__(self, config: ProposalNetworkConfig) -> None:
        super().__init__()
        self.backbone = PointBackbone(config.backbone)
        channels, dropout = (config.backbone.out_channels, (config.head_width,)), config.dropout
        self.class_head, self.box_head = (
            head_layers(*channels, width, batch_norm=True, dropout=dropout)
            for width in (len(config.classes), config.coding.channels)
        )
        last: nn.Linear = self.class_head[-1]  # type: ignore[assignment]
        nn.init.constant_(last.bias, -math.log((1 - _PRIOR) / _PRIOR))
        last = self.box_head[-1]  # type: ignore[assignment]
        nn.init.normal_(last.weight, std=0.001)

    def forward(
        self,
        points: Float[Tensor, "batch num_points 3"],
        features: Float[Tensor, "batch num_points in_channels"] | None = None,
        **found: Tensor,
    ) -> ProposalNetworkOutput:
        """Compute features, class logits and box values of the output of `PointProposals.inputs`.

        Args:
            points: x, y, z (LiDAR frame [m]).
            features: Further features of each point. None: none.
            found: Output of the backbone's `find`.
        """
        seen = self.backbone(points, points[..., :0] if features is None else features, found)
        return ProposalNetworkOutput(seen, self.class_head(seen), self.box_head(seen))


def decode_points(
    output: ProposalNetworkOutput,
    points: Float[Tensor, "batch num_points 3"],
    config: ProposalNetworkConfig,
) -> list[Proposed]:
    """Decode each sweep's boxes, one of each point [m], in case it lies on an object.

    The class is the most likely one, the score the probability that the point lies on one of it.
    """
    scores, classes = output.class_logits.sigmoid().max(dim=2)
    mean_sizes = points.new_tensor([entry.mean_size_m for entry in config.classes])
    code = likeliest_code(split_prediction(output.box_values.flatten(0, 1), config.coding))
    means = mean_sizes[classes].flatten(0, 1)
    boxes = decode_boxes(code, points.flatten(0, 1), means, config.coding)
    columns = boxes.reshape(*points.shape[:2], 7), classes, scores, output.features
    return [Proposed(*sweep) for sweep in zip(*columns, strict=True)]


def choose_proposals(
    boxes: Float[Tensor, "num_boxes 7"], scores: Float[Tensor, " num_boxes"], config: ProposalConfig
) -> Int64[Tensor, " num_proposals"]:
    """Select proposals: indices of the near boxes by descending score, then of the far ones.

    Near and far boxes are each limited to their share of candidates by score, then thinned by
    non-maximum suppression from above, then limited to their share of proposals. If there are no
    far boxes, or no near ones, the other group takes both shares.

    Departure: distance is measured over the ground from the sensor, not along its axis, and has no
    limit.
    """
    is_near = torch.hypot(boxes[:, 0], boxes[:, 1]) <= config.near_m
    share = config.near_share
    if bool(is_near.all()) or not bool(is_near.any()):
        share = float(bool(is_near.any()))
    near_candidates = round(share * config.num_candidates)
    near_proposals = round(share * config.num_proposals)
    chosen = []
    for mask, num_candidates, num_proposals in (
        (is_near, near_candidates, near_proposals),
        (~is_near, config.num_candidates - near_candidates, config.num_proposals - near_proposals),
    ):
        places = mask.nonzero()[:, 0]
        best = places[scores[places].argsort(descending=True, stable=True)[:num_candidates]]
        kept = nms_bev(
            Boxes3D(boxes[best]).bev, scores[best], config.iou, max_detections=num_proposals
        )
        chosen.append(best[kept])
    return torch.cat(chosen)


class PointProposals(FirstStage):
    """First stage for sweeps with the same number of points."""

    output_type = ProposalNetworkOutput
    network: ProposalNetwork

    def __init__(
        self,
        config: ProposalNetworkConfig,
        proposals: ProposalConfig,
        training_proposals: ProposalConfig,
    ) -> None:
        super().__init__()
        self.config = config
        self.proposals = proposals
        self.training_proposals = training_proposals
        self.feature_channels = config.backbone.out_channels
        self.network = ProposalNetwork(config)

    def inputs(self, sweeps: Sequence[Sweep]) -> dict[str, Tensor]:
        """Collect points and neighbourhoods; the search has no gradient and runs on the CPU."""
        together = torch.stack(list(sweeps))
        points, extra = together[..., :3].contiguous(), self.config.backbone.in_channels
        given = {"points": points}
        if extra:
            given["features"] = together[..., 3 : 3 + extra].contiguous()
        return given | self.network.backbone.find(points)

    def propose(
        self, output: ProposalNetworkOutput, sweeps: Sequence[Sweep], *, training: bool
    ) -> tuple[Proposed, ...]:
        """Select proposals among the boxes: near ones by descending score, then far ones."""
        config = self.training_proposals if training else self.proposals
        points = torch.stack([sweep[:, :3] for sweep in sweeps])
        with torch.no_grad():
            values = ProposalNetworkOutput(*(each.detach().float() for each in output))
            decoded = decode_points(values, points, self.config)
        return tuple(
            each.select(choose_proposals(each.boxes, each.scores, config))._replace(features=given)
            for each, given in zip(decoded, output.features, strict=True)
        )

    def losses(
        self,
        output: ProposalNetworkOutput,
        sweeps: Sequence[Sweep],
        truths: Sequence[SweepTruth],
        config: Detection3DLossConfig,
    ) -> ProposalLosses:
        """Compute `proposal_loss`; points on ignored objects do not count."""
        boxes, classes = [], []
        for truth in truths:
            ignored = truth.classes.new_full((len(truth.ignored_boxes),), IGNORED)
            boxes.append(torch.cat((truth.boxes, truth.ignored_boxes)).float())
            classes.append(torch.cat((truth.classes, ignored)))
        return proposal_loss(
            ProposalNetworkOutput(*(values.float() for values in output)),
            torch.stack([sweep[:, :3] for sweep in sweeps]),
            pad_sequence(boxes, batch_first=True),
            pad_sequence(classes, batch_first=True),
            self.config,
            config.points,
        )

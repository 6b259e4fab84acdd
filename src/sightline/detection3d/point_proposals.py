"""First stage of Shi et al. 2019 (PointRCNN): a box for every point."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.utils.rnn import pad_sequence

from sightline.detection3d.foreground import IGNORED
from sightline.detection3d.loss_config import Detection3DLossConfig
from sightline.detection3d.proposal_loss import ProposalLosses, proposal_loss
from sightline.detection3d.proposal_network import (
    ProposalNetwork,
    ProposalNetworkConfig,
    ProposalNetworkOutput,
    tell_boxes,
)
from sightline.detection3d.proposals import ProposalConfig, choose_proposals
from sightline.detection3d.stages import Proposed, Sweep
from sightline.detection3d.targets import SweepTruth
from sightline.detection3d.views import AS_IT_IS


class PointProposals(nn.Module):
    """`FirstStage` for sweeps with the same number of points."""

    output_type = ProposalNetworkOutput
    views = (AS_IT_IS,)

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
        self.max_proposals = proposals.num_proposals
        self.feature_channels = config.backbone.out_channels
        self.network = ProposalNetwork(config)

    def forward(
        self,
        points: Float[Tensor, "batch num_points 3"],
        features: Float[Tensor, "batch num_points in_channels"] | None = None,
        **found: Tensor,
    ) -> ProposalNetworkOutput:
        """Run the network on points, optional features, and the neighbourhoods of `inputs`."""
        if features is None:
            features = points[..., :0]
        output: ProposalNetworkOutput = self.network(points, features, found)
        return output

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
            boxes, classes, scores = tell_boxes(
                ProposalNetworkOutput(*(values.detach().float() for values in output)),
                points,
                self.config,
            )
        proposed = []
        for number, features in enumerate(output.features):
            kept = choose_proposals(boxes[number], scores[number], config)
            proposals = (values[number][kept] for values in (boxes, classes, scores))
            proposed.append(Proposed(*proposals)._replace(features=features))
        return tuple(proposed)

    def losses(
        self,
        output: ProposalNetworkOutput,
        sweeps: Sequence[Sweep],
        truths: Sequence[SweepTruth],
        config: Detection3DLossConfig,
    ) -> ProposalLosses:
        """Compute `proposal_loss`; points on ignored objects do not count."""
        points = torch.stack([sweep[:, :3] for sweep in sweeps])
        boxes = [torch.cat((truth.boxes, truth.ignored_boxes)).float() for truth in truths]
        classes = [
            torch.cat((truth.classes, truth.classes.new_full((len(truth.ignored_boxes),), IGNORED)))
            for truth in truths
        ]
        whole = ProposalNetworkOutput(*(values.float() for values in output))
        return proposal_loss(
            whole,
            points,
            pad_sequence(boxes, batch_first=True),
            pad_sequence(classes, batch_first=True),
            self.config,
            config.points,
        )

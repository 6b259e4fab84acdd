"""Compact first stage: centres and boxes from a map of pillars."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn

from sightline.detection3d.loss_config import Detection3DLossConfig
from sightline.detection3d.pillar_config import PillarNetworkConfig
from sightline.detection3d.pillar_detections import PillarDetectionConfig, find_boxes
from sightline.detection3d.pillar_features import pillar_features
from sightline.detection3d.pillar_loss import PillarLosses, pillar_loss
from sightline.detection3d.pillar_network import PillarNetwork, PillarOutput
from sightline.detection3d.pillar_targets import PillarTargets, pillar_targets
from sightline.detection3d.pillar_views import pillar_views
from sightline.detection3d.stages import Proposed, Sweep
from sightline.detection3d.targets import SweepTruth


class PillarProposals(nn.Module):
    """`FirstStage` for sweeps with any number of points."""

    output_type = PillarOutput
    feature_channels = 0

    def __init__(self, config: PillarNetworkConfig, centers: PillarDetectionConfig) -> None:
        super().__init__()
        self.config = config
        self.centers = centers
        self.max_proposals = centers.max_boxes
        self.views = pillar_views(config.grid)
        self.network = PillarNetwork(config)

    def forward(self, pillars: Float[Tensor, "batch channels rows columns"]) -> PillarOutput:
        """Run the network on maps of pillars."""
        output: PillarOutput = self.network(pillars)
        return output

    def inputs(self, sweeps: Sequence[Sweep]) -> dict[str, Tensor]:
        """Compute the sweeps' pillar maps, channels last."""
        maps = [pillar_features(sweep, self.config.grid) for sweep in sweeps]
        as_they_lie = torch.stack([each.permute(1, 2, 0) for each in maps])
        return {"pillars": as_they_lie.permute(0, 3, 1, 2)}

    @torch.no_grad()
    def propose(
        self, output: PillarOutput, sweeps: Sequence[Sweep], *, training: bool
    ) -> tuple[Proposed, ...]:
        """Decode by `find_boxes`; the same in training."""
        del training
        found = (
            find_boxes(output, number, self.config, self.centers) for number in range(len(sweeps))
        )
        return tuple(Proposed(*boxes) for boxes in found)

    def losses(
        self,
        output: PillarOutput,
        sweeps: Sequence[Sweep],
        truths: Sequence[SweepTruth],
        config: Detection3DLossConfig,
    ) -> PillarLosses:
        """Compute `pillar_loss`."""
        del sweeps
        grid, device = self.config.grid, output.heat_logits.device
        scenes = [truth.cpu() for truth in truths]
        targets = pillar_targets(scenes, len(self.config.classes), grid, config.cells)
        moved = PillarTargets(*(values.to(device) for values in targets))
        return pillar_loss(output, moved, self.config, config.pillars)

"""Compact second stage: refine proposals from their points in their own frames."""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from sightline.detection3d.loss_config import Detection3DLossConfig
from sightline.detection3d.pillar_detections import FoundBoxes
from sightline.detection3d.region_coding import decode_regions
from sightline.detection3d.region_config import RegionConfig
from sightline.detection3d.region_examples import RegionExamples, region_examples
from sightline.detection3d.region_loss import RegionLosses, region_loss
from sightline.detection3d.region_network import RegionNetwork, RegionOutput
from sightline.detection3d.region_views import REGION_VIEWS
from sightline.detection3d.regions import cut_regions
from sightline.detection3d.stages import Proposed, Refined, Regions, Sweep
from sightline.detection3d.targets import SweepTruth


class RegionStage(nn.Module):
    """`SecondStage`: `RegionNetwork` on the output of `cut_regions`."""

    output_type = RegionOutput
    views = REGION_VIEWS

    def __init__(self, config: RegionConfig) -> None:
        super().__init__()
        self.config = config
        self.passes = config.passes
        self.mean_with_first = config.mean_with_first
        self.network = RegionNetwork(config)

    def forward(
        self,
        points: Float[Tensor, "num_regions roi_points point_channels"],
        context: Float[Tensor, "num_regions context_channels"],
    ) -> RegionOutput:
        """Run the network on points and contexts of regions."""
        output: RegionOutput = self.network(points, context)
        return output

    def regions(self, sweep: Sweep, proposed: Proposed, *, seed: int) -> Regions:
        """Draw points around proposals, with their reflectance or other features."""
        features = proposed.features
        if features is None:
            features = sweep[:, 3 : 3 + self.config.in_channels]
        points, boxes = sweep[:, :3].contiguous(), proposed.boxes
        cut = cut_regions(points, features, boxes, proposed.classes, self.config, seed=seed)
        every = torch.arange(len(boxes), device=boxes.device)
        return Regions(every, boxes, proposed.scores, cut._asdict())

    def examples(
        self,
        sweep: Sweep,
        proposed: Proposed,
        truth: SweepTruth,
        config: Detection3DLossConfig,
        *,
        seed: int,
    ) -> tuple[Regions, RegionExamples]:
        """Make moved ground truths, background and proposals; see `region_examples`."""
        usable = (proposed.boxes[:, 3:6] > 0).all(dim=1)
        found = FoundBoxes(*(values[usable].cpu() for values in proposed[:3]))
        drawn = region_examples(
            truth.cpu(),
            sweep[:, :3].cpu(),
            self.config.classes,
            np.random.default_rng(seed),
            config.region_examples,
            found=found,
        )
        wanted = RegionExamples(*(values.to(sweep.device) for values in drawn))
        boxes = wanted.proposals.to(sweep.dtype)
        scores = boxes.new_ones(len(boxes))
        moved = Proposed(boxes, wanted.classes, scores, proposed.features)
        return self.regions(sweep, moved, seed=seed), wanted

    def refine(self, output: RegionOutput, regions: Regions) -> Refined:
        """Decode boxes; scores are products of powers of proposal scores and qualities."""
        boxes = decode_regions(output.values, output.front_logits >= 0, regions.boxes)
        share = self.config.quality_share
        scores = regions.scores ** (1 - share) * output.quality_logits.sigmoid() ** share
        return Refined(boxes, scores, output.front_logits.abs())

    def losses(
        self,
        output: RegionOutput,
        regions: Regions,
        wanted: RegionExamples,
        config: Detection3DLossConfig,
    ) -> RegionLosses:
        """Compute `region_loss`."""
        return region_loss(output, regions.boxes, wanted.truths, wanted.is_object, config.regions)

"""Second stage on regions: points in the frame of each proposal, and a small point network."""

from collections.abc import Mapping
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn

from sightline.detection3d.config import Detection3DLossConfig
from sightline.detection3d.pillars.boxes import (
    REGION_VALUES,
    RegionOutput,
    decode_regions,
    turn_regions,
)
from sightline.detection3d.pillars.region_config import RegionConfig
from sightline.detection3d.pillars.region_training import (
    RegionExamples,
    RegionLosses,
    region_examples,
    region_loss,
)
from sightline.detection3d.stages import (
    UNCHANGED,
    Proposed,
    Refined,
    Regions,
    SecondStage,
    StageView,
)
from sightline.detection3d.sweeps import Sweep, SweepTruth
from sightline.ops.roi_points import roi_points

RANGE_SCALE_M = 40.0
REGION_COUNT_SCALE = 0.25  # factor on log(1 + number of points)


class CutRegions(NamedTuple):
    """Network input of the second stage."""

    points: Float[Tensor, "num_regions roi_points point_channels"]
    """Canonical: x, y, z in the proposal's frame [m], the distances to its six faces [m], and
    features; else x, y, z in the sweep's frame and features."""
    context: Float[Tensor, "num_regions context_channels"]
    """Logarithms of the sizes over the class's mean, range, cosine and sine of the bearing in the
    proposal's frame, number of points, and the one-hot class."""


def cut_regions(
    points: Float[Tensor, "num_points 3"],
    features: Float[Tensor, "num_points in_channels"],
    boxes: Float[Tensor, "num_regions 7"],
    classes: Int64[Tensor, " num_regions"],
    config: RegionConfig,
    *,
    seed: int,
) -> CutRegions:
    """Draw points in and around each proposal of a sweep, in its frame if canonical.

    As in Shi et al. 2019 (PointRCNN), section 3.3, the frame's origin is the proposal's centre and
    x its heading. The distances to the faces give the network the proposal's size: Li et al. 2021
    (LiDAR R-CNN; boundary offset). If there are too few points, some are repeated
    (`ops.roi_points`), which does not change their maxima; regions without points are all 0.
    Nothing depends on the direction of the sensor's x axis. The draw is reproducible by its seed.
    Boxes are x, y, z, length, width, height, yaw (LiDAR frame, metres, radians).
    """
    margin = boxes.new_tensor(config.margin_m)
    around = torch.cat((boxes[:, :3], boxes[:, 3:6] + 2 * margin, boxes[:, 6:]), dim=1)
    drawn = roi_points(points[None], around[None], margin_m=0.0, count=config.num_points, seed=seed)
    index, num_inside = drawn.indices[0], drawn.num_inside[0]
    if len(points) == 0:
        points, features = points.new_zeros(1, 3), features.new_zeros(1, features.shape[1])
    place = points[index]
    if config.canonical:
        x, y, z = (place - boxes[:, None, :3]).unbind(dim=2)
        cos, sin = boxes[:, 6:].cos(), boxes[:, 6:].sin()
        place = torch.stack((cos * x + sin * y, cos * y - sin * x, z), dim=2)
        half = boxes[:, None, 3:6] / 2
        place = torch.cat((place, half - place, half + place), dim=2)
    described = torch.cat((place, features[index]), dim=2)
    is_empty = (num_inside == 0)[:, None, None]
    return CutRegions(
        points=torch.where(is_empty, 0.0, described),
        context=_context(boxes, classes, num_inside, config),
    )


def flip_heading(cut: CutRegions) -> CutRegions:
    """Convert canonical regions to those of proposals turned by half a turn."""
    points = cut.points.clone()
    points[..., :2] *= -1
    points[..., [3, 4, 6, 7]] = cut.points[..., [6, 7, 3, 4]]  # faces but top and bottom
    context = cut.context.clone()
    context[:, 4:6] *= -1  # cosine and sine of the bearing
    return CutRegions(points, context)


def _context(
    boxes: Float[Tensor, "num_regions 7"],
    classes: Int64[Tensor, " num_regions"],
    num_inside: Int64[Tensor, " num_regions"],
    config: RegionConfig,
) -> Float[Tensor, "num_regions context_channels"]:
    mean_sizes = boxes.new_tensor([entry.mean_size_m for entry in config.classes])[classes]
    bearing = torch.atan2(boxes[:, 1], boxes[:, 0]) - boxes[:, 6]
    numbers = (
        boxes[:, :2].norm(dim=1) / RANGE_SCALE_M,
        bearing.cos(),
        bearing.sin(),
        REGION_COUNT_SCALE * torch.log1p(num_inside.to(boxes.dtype)),
    )
    is_class = classes[:, None] == torch.arange(len(config.classes), device=boxes.device)
    sizes = torch.log(boxes[:, 3:6] / mean_sizes)
    return torch.cat((sizes, torch.stack(numbers, dim=1), is_class.to(boxes.dtype)), dim=1)


class RegionNetwork(nn.Module):
    """Layers for each point, with their maxima fed back to each point, and one head.

    It is a PointNet (Qi et al. 2017) with the maxima in between, as in its segmentation network.
    Layer norms make the result independent of the number of regions. Initially it changes nothing.
    """

    def __init__(self, config: RegionConfig) -> None:
        super().__init__()
        self.point_layers = _layers(config.point_channels, config.point_widths)
        last = config.point_widths[-1]
        # one layer for own and pooled features: the pooled part once for each region
        self.own_part = nn.Linear(last, config.region_width)
        self.common_part = nn.Linear(last, config.region_width, bias=False)
        self.activate = nn.Sequential(nn.LayerNorm(config.region_width), nn.ReLU(inplace=True))
        self.head = _layers(config.region_width + config.context_channels, config.head_widths)
        self.answer = nn.Linear(config.head_widths[-1], REGION_VALUES + 2)
        nn.init.zeros_(self.answer.weight)
        nn.init.zeros_(self.answer.bias)

    def forward(
        self,
        points: Float[Tensor, "num_regions roi_points point_channels"],
        context: Float[Tensor, "num_regions context_channels"],
    ) -> RegionOutput:
        """Compute a change for each region of `CutRegions`; there may be none."""
        own = self.point_layers(points)
        common = self.common_part(own.amax(dim=1, keepdim=True))
        region = self.activate(self.own_part(own) + common).amax(dim=1)
        output = self.answer(self.head(torch.cat((region, context), dim=1))).float()
        values, front, quality = output.split((REGION_VALUES, 1, 1), dim=1)
        return RegionOutput(values, front[:, 0], quality[:, 0])


def _layers(in_channels: int, widths: tuple[int, ...]) -> nn.Sequential:
    layers: list[nn.Module] = []
    for before, width in pairwise((in_channels, *widths)):
        layers += [nn.Linear(before, width), nn.LayerNorm(width), nn.ReLU(inplace=True)]
    return nn.Sequential(*layers)


def _turn(inputs: Mapping[str, Tensor]) -> dict[str, Tensor]:
    return flip_heading(CutRegions(**inputs))._asdict()


def _turn_back(output: RegionOutput) -> RegionOutput:
    return output._replace(values=turn_regions(output.values), front_logits=-output.front_logits)


class RegionStage(SecondStage):
    """Second stage: `RegionNetwork` on the output of `cut_regions`.

    The flip test needs canonical regions, as `Detection3DConfig` checks.
    """

    output_type = RegionOutput
    views = UNCHANGED, StageView(_turn, _turn_back)

    def __init__(self, config: RegionConfig) -> None:
        super().__init__()
        self.config = config
        self.passes = config.passes
        self.mean_with_first = config.mean_with_first
        self.network = RegionNetwork(config)

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
        found = Proposed(*(values.cpu() for values in proposed.select(usable)[:3]))
        drawn = region_examples(
            truth.cpu(),
            sweep[:, :3].cpu(),
            self.config.classes,
            np.random.default_rng(seed),
            config.region_examples,
            found=found,
        )
        examples = RegionExamples(*(values.to(sweep.device) for values in drawn))
        boxes = examples.proposals.to(sweep.dtype)
        scores = boxes.new_ones(len(boxes))
        moved = Proposed(boxes, examples.classes, scores, proposed.features)
        return self.regions(sweep, moved, seed=seed), examples

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
        examples: RegionExamples,
        config: Detection3DLossConfig,
    ) -> RegionLosses:
        """Compute `region_loss`."""
        return region_loss(
            output, regions.boxes, examples.truths, examples.is_object, config.regions
        )

"""The compact second stage's network: how a proposal's points say that it should be changed."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from sightline.detection3d.region_coding import REGION_VALUES
from sightline.detection3d.region_config import RegionConfig


class RegionOutput(NamedTuple):
    """What the second stage gives for each region."""

    values: Float[Tensor, "num_regions 8"]
    """The change of the box, as `region_coding` tells it."""
    front_logits: Float[Tensor, " num_regions"]
    """That the front is where the proposal has it, before the sigmoid."""
    quality_logits: Float[Tensor, " num_regions"]
    """How good the changed box is (`quality`), before the sigmoid."""


class RegionNetwork(nn.Module):
    """Layers for each point, their maxima told to each point again, and one head.

    A PointNet (Qi et al. 2017) with the maxima in between as in its segmentation network. Layer
    norms keep it the same for one region or many. At first it changes nothing.
    """

    def __init__(self, config: RegionConfig) -> None:
        super().__init__()
        self.point_layers = _layers(config.point_channels, config.point_widths)
        last = config.point_widths[-1]
        # one layer for what a point tells and what is common: the latter once for each region
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
        """A change for each region, given as `regions.CutRegions` has it; no regions give none."""
        own = self.point_layers(points)
        common = self.common_part(own.amax(dim=1, keepdim=True))
        region = self.activate(self.own_part(own) + common).amax(dim=1)
        answer = self.answer(self.head(torch.cat((region, context), dim=1))).float()
        values, front, quality = answer.split((REGION_VALUES, 1, 1), dim=1)
        return RegionOutput(values, front[:, 0], quality[:, 0])


def _layers(in_channels: int, widths: tuple[int, ...]) -> nn.Sequential:
    layers: list[nn.Module] = []
    for width in widths:
        layers += [nn.Linear(in_channels, width), nn.LayerNorm(width), nn.ReLU(inplace=True)]
        in_channels = width
    return nn.Sequential(*layers)

"""Network of the compact second stage: from a proposal's points to the change of its box."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from sightline.detection3d.region_coding import REGION_VALUES
from sightline.detection3d.region_config import RegionConfig


class RegionOutput(NamedTuple):
    """Output of the second stage for each region."""

    values: Float[Tensor, "num_regions 8"]
    """Change of the box; see `region_coding`."""
    front_logits: Float[Tensor, " num_regions"]
    """Logit that the front stays at the proposal's end."""
    quality_logits: Float[Tensor, " num_regions"]
    """Logit of the quality of the changed box (`quality`)."""


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
        """Compute a change for each region of `regions.CutRegions`; there may be none."""
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

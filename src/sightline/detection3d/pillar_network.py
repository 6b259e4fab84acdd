"""Network of the compact first stage: pillar maps to centres and boxes."""

import math
from typing import NamedTuple

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from sightline.detection3d.center_coding import CENTER_VALUES
from sightline.detection3d.pillar_config import PillarNetworkConfig

_INITIAL_HEAT = 0.03  # heat of every cell before training
_NORM_MOMENTUM = 0.05  # batches are of a few sweeps


class ConvNorm(nn.Sequential):
    """Convolution, batch norm, ReLU. Depthwise convolutions take longer on CPUs than dense ones."""

    def __init__(self, in_channels: int, out_channels: int, stride: int = 1) -> None:
        super().__init__(
            nn.Conv2d(in_channels, out_channels, 3, stride, padding=1, bias=False),
            nn.BatchNorm2d(out_channels, momentum=_NORM_MOMENTUM),
            nn.ReLU(inplace=True),
        )


class ResidualBlock(nn.Module):
    """Two convolutions beside the identity: He et al. 2016, with the ReLU after the sum."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.first = ConvNorm(channels, channels)
        self.second = nn.Sequential(
            nn.Conv2d(channels, channels, 3, padding=1, bias=False),
            nn.BatchNorm2d(channels, momentum=_NORM_MOMENTUM),
        )
        self.activate = nn.ReLU(inplace=True)

    def forward(
        self, maps: Float[Tensor, "batch channels rows columns"]
    ) -> Float[Tensor, "batch channels rows columns"]:
        """Compute maps of the same size and channels."""
        changed: Tensor = self.activate(maps + self.second(self.first(maps)))
        return changed


class PillarOutput(NamedTuple):
    """Output of the first stage for each cell and class."""

    heat_logits: Float[Tensor, "batch classes rows columns"]
    """Logit that an object's centre is in the cell."""
    center_values: Float[Tensor, "batch classes values rows columns"]
    """Box of a nearby object and its quality; see `center_coding`."""


class PillarNetwork(nn.Module):
    """Residual stages, an upsampling path, and a centre head.

    After Yin et al. 2021 (CenterPoint), section 4, without its second stage: a heat map and a box
    for each class, here each by a layer of its own.
    """

    def __init__(self, config: PillarNetworkConfig) -> None:
        super().__init__()
        self.num_classes = len(config.classes)
        fine, middle, coarse = config.channels
        self.stages = nn.ModuleList(
            nn.Sequential(
                ConvNorm(before, width, stride=2), *(ResidualBlock(width) for _ in range(blocks))
            )
            for before, width, blocks in zip(
                (config.grid.channels, fine, middle), config.channels, config.blocks, strict=True
            )
        )
        width = config.head_channels
        self.coarse_to_middle = nn.Conv2d(coarse, middle, 1)
        self.mix_middle = ConvNorm(middle, middle)
        self.middle_to_fine = nn.Conv2d(middle, width, 1)
        self.fine_to_head = nn.Conv2d(fine, width, 1)
        self.tower = nn.Sequential(
            nn.ReLU(inplace=True), ConvNorm(width, width), ConvNorm(width, width)
        )
        self.heat = nn.Conv2d(width, self.num_classes, 1)
        self.center = nn.Conv2d(width, self.num_classes * CENTER_VALUES, 1)
        assert self.heat.bias is not None, "made with one"
        nn.init.constant_(self.heat.bias, -math.log(1 / _INITIAL_HEAT - 1))

    def forward(self, pillars: Float[Tensor, "batch channels height width"]) -> PillarOutput:
        """Compute output maps from pillar maps, at half their rows and columns."""
        fine = self.stages[0](pillars)
        middle = self.stages[1](fine)
        coarse = self.stages[2](middle)
        middle = self.mix_middle(middle + _twice(self.coarse_to_middle(coarse)))
        seen = self.tower(self.fine_to_head(fine) + _twice(self.middle_to_fine(middle)))
        heat, center = self.heat(seen).float(), self.center(seen).float()
        return PillarOutput(heat, center.unflatten(1, (self.num_classes, CENTER_VALUES)))


def _twice(
    maps: Float[Tensor, "batch channels _rows _columns"],
) -> Float[Tensor, "batch channels _more_rows _more_columns"]:
    return F.interpolate(maps, scale_factor=2.0)

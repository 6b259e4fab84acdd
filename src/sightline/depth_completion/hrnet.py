"""Light high-resolution network: parallel scales that repeatedly exchange features."""

from collections.abc import Sequence
from itertools import pairwise

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from sightline.depth_completion.config import TrunkConfig
from sightline.networks.residual import ConvNorm


class Bottleneck(nn.Module):
    """Residual block of 1x1, 3x3, 1x1: He et al. 2016, Fig. 5 right, without its widening."""

    def __init__(self, channels: int, reduction: int) -> None:
        super().__init__()
        narrow = channels // reduction
        self.body = nn.Sequential(
            ConvNorm(channels, narrow, kernel_px=1),
            ConvNorm(narrow, narrow),
            ConvNorm(narrow, channels, kernel_px=1, relu=False),
        )

    def forward(
        self, maps: Float[Tensor, "batch channels height width"]
    ) -> Float[Tensor, "batch channels height width"]:
        """Add the correction to the maps."""
        return F.relu(maps + self.body(maps))


class Exchange(nn.Module):
    """Exchange between scales: each becomes the sum over all, Wang et al. 2020, Fig. 3.

    Downwards: one 3x3 convolution of stride 2 for each halving. Upwards: a 1x1 convolution, then
    nearest-neighbour upsampling.
    """

    def __init__(self, config: TrunkConfig) -> None:
        super().__init__()
        scales = range(len(config.channels))
        reach = len(config.channels) if config.exchange == "all" else 1
        self.sources = [[s for s in scales if abs(s - target) <= reach] for target in scales]
        self.paths = nn.ModuleList(
            nn.ModuleList(
                _exchange_path(config.channels, source, target) for source in self.sources[target]
            )
            for target in scales
        )

    def forward(self, scales: list[Tensor]) -> list[Tensor]:
        """Return maps of the same sizes and channels, the largest first."""
        mixed = []
        for target, paths in enumerate(self.paths):
            size = scales[target].shape[-2:]
            total = scales[target]
            for source, path in zip(self.sources[target], paths.children(), strict=True):
                if source < target:
                    total = total + path(scales[source])
                elif source > target:
                    total = total + F.interpolate(path(scales[source]), size=size, mode="nearest")
            mixed.append(F.relu(total))
        return mixed


class HighResolutionTrunk(nn.Module):
    """The HRNet with fewer layers of Yu and Kee 2021: section 3.2, Fig. 9.

    Each module has bottlenecks at every scale, fewer at the smallest, then an exchange. At the end
    all maps are upsampled to the largest size and go through one convolution together.
    """

    def __init__(self, in_channels: int, out_channels: int, config: TrunkConfig) -> None:
        super().__init__()
        channels = config.channels
        self.entry = (
            nn.Identity()
            if in_channels == channels[0]
            else ConvNorm(in_channels, channels[0], kernel_px=1)
        )
        self.down = nn.ModuleList(
            ConvNorm(large, small, stride=2) for large, small in pairwise(channels)
        )
        self.blocks = nn.ModuleList(
            nn.ModuleList(_blocks(config, scale) for scale in range(len(channels)))
            for _ in range(config.modules)
        )
        self.exchanges = nn.ModuleList(Exchange(config) for _ in range(config.modules))
        kernel_px = config.head_kernel_px
        self.head = nn.Conv2d(sum(channels), out_channels, kernel_px, padding=kernel_px // 2)

    def forward(
        self, maps: Float[Tensor, "batch in_channels height width"]
    ) -> Float[Tensor, "batch out_channels height width"]:
        """Run the trunk; height and width must be multiples of the config's `stride`."""
        scales = [self.entry(maps)]
        for down in self.down:
            scales.append(down(scales[-1]))
        for module, exchange in zip(self.blocks, self.exchanges, strict=True):
            assert isinstance(module, nn.ModuleList)
            processed = [blocks(scale) for blocks, scale in zip(module, scales, strict=True)]
            scales = exchange(processed)
        size = scales[0].shape[-2:]
        smaller = [F.interpolate(scale, size=size, mode="nearest") for scale in scales[1:]]
        output: Tensor = self.head(torch.cat((scales[0], *smaller), dim=1))
        return output


def _blocks(config: TrunkConfig, scale: int) -> nn.Sequential:
    is_lowest = scale == len(config.channels) - 1
    count = config.lowest_blocks if is_lowest else config.blocks
    return nn.Sequential(
        *(Bottleneck(config.channels[scale], config.reduction) for _ in range(count))
    )


def _exchange_path(channels: Sequence[int], source: int, target: int) -> nn.Module:
    if source > target:
        return ConvNorm(channels[source], channels[target], kernel_px=1, relu=False)
    halvings = range(source, target)
    return nn.Sequential(
        *(
            ConvNorm(channels[scale], channels[scale + 1], stride=2, relu=scale + 1 < target)
            for scale in halvings
        )
    )

"""U-Net trunk: one path down to small maps and back up, with the maps on the way beside it."""

from itertools import pairwise

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from sightline.depth_completion.config import TrunkConfig
from sightline.depth_completion.hrnet import conv_norm


class UNetTrunk(nn.Module):
    """U-Net after Ronneberger et al. 2015, with the image's mean features at the bottom.

    Two convolutions a scale on the way down, one on the way up; sees the whole frame, which depth
    from an image alone needs.
    """

    def __init__(self, in_channels: int, out_channels: int, config: TrunkConfig) -> None:
        super().__init__()
        channels = config.channels
        self.entry = conv_norm(in_channels, channels[0])
        self.down = nn.ModuleList(
            nn.Sequential(conv_norm(large, small, stride=2), conv_norm(small, small))
            for large, small in pairwise(channels)
        )
        self.up = nn.ModuleList(
            conv_norm(large + small, large) for large, small in reversed(list(pairwise(channels)))
        )
        self.head = nn.Conv2d(channels[0], out_channels, kernel_size=3, padding=1)

    def forward(
        self, maps: Float[Tensor, "batch in_channels height width"]
    ) -> Float[Tensor, "batch out_channels height width"]:
        """Run the trunk; height and width must be multiples of the config's `stride`."""
        scales = [self.entry(maps)]
        for down in self.down:
            scales.append(down(scales[-1]))
        deepest = scales.pop()
        rising = deepest + deepest.mean(dim=(2, 3), keepdim=True)
        for up in self.up:
            beside = scales.pop()
            larger = F.interpolate(rising, size=beside.shape[-2:], mode="nearest")
            rising = up(torch.cat((larger, beside), dim=1))
        output: Tensor = self.head(rising)
        return output

"""Sensor stream: VGG16 as SSD300 uses it, for images of any size."""

from typing import Final

import torch
from jaxtyping import Float
from torch import Tensor, nn

from sightline.detection2d.config import scaled
from sightline.detection2d.initialization import start_small

VGG_CONVS: Final = ((64, 64), (128, 128), (256, 256, 256), (512, 512, 512), (512, 512, 512))
"""Channels of VGG16's convolutions; maps are halved between the groups."""
MAP_CHANNELS: Final = (512, 1024, 512, 256, 256, 256)
"""Channels of conv4_3, fc7, conv8_2, conv9_2, conv10_2 and conv11_2."""

_FC_CHANNELS = 1024
_FC6_DILATION = 6
# Of conv8 to conv11: channels of the 1x1 convolution; of the 3x3 one; its stride and padding.
_EXTRAS = ((256, 512, 2, 1), (128, 256, 2, 1), (128, 256, 1, 0), (128, 256, 1, 0))


class L2Norm(nn.Module):
    """Normalisation of each pixel's channels to a learned length: Liu et al. 2016 (ParseNet)."""

    def __init__(self, channels: int, scale: float) -> None:
        super().__init__()
        self.scale = nn.Parameter(torch.full((channels,), scale))

    def forward(
        self, maps: Float[Tensor, "batch channels rows columns"]
    ) -> Float[Tensor, "batch channels rows columns"]:
        """Normalise the maps; all-zero pixels stay zero."""
        return nn.functional.normalize(maps, dim=1) * self.scale[:, None, None]


class VggStream(nn.Module):
    """Layers of VGG16 up to conv5_3, then SSD's: Liu et al. 2016, section 3.1 and Fig. 2.

    Kim et al. 2018 use six of its maps. Pooling rounds sizes up, as in SSD's own Caffe program: an
    input of 375x1242 gives maps of 47x156, 24x78, 12x39, 6x20, 4x18 and 2x16.

    Args:
        in_channels: Channels of the sensor's image.
        width: Factor on the channels of all layers.
        l2_norm_scale: Initial scale of conv4_3's features.
        batch_norm: Whether convolutions have batch normalisation.
    """

    smallest_px = 257
    """Smallest height and width for which the last map is not empty."""

    def __init__(
        self, in_channels: int, width: float, l2_norm_scale: float, *, batch_norm: bool = False
    ) -> None:
        super().__init__()

        def then(conv: nn.Conv2d) -> list[nn.Module]:
            """The convolution and the layers after it."""
            norm = [nn.BatchNorm2d(conv.out_channels)] if batch_norm else []
            return [conv, *norm, nn.ReLU()]

        stages: list[nn.Sequential] = []
        channels = in_channels
        for group in VGG_CONVS:
            layers: list[nn.Module] = []
            if stages:
                layers.append(nn.MaxPool2d(2, ceil_mode=True))
            for wanted in group:
                layers += then(nn.Conv2d(channels, scaled(wanted, width), 3, padding=1))
                channels = scaled(wanted, width)
            stages.append(nn.Sequential(*layers))
        fc = scaled(_FC_CHANNELS, width)
        self.num_to_conv5_3 = len(stages[4])  # of the layers to fc7
        self.to_conv4_3 = nn.Sequential(*stages[:4])
        self.norm = L2Norm(channels, l2_norm_scale)
        self.to_fc7 = nn.Sequential(
            *stages[4],
            nn.MaxPool2d(3, stride=1, padding=1),
            *then(nn.Conv2d(channels, fc, 3, padding=_FC6_DILATION, dilation=_FC6_DILATION)),
            *then(nn.Conv2d(fc, fc, 1)),
        )
        extras = []
        channels = fc
        for narrow, wide, stride, padding in _EXTRAS:
            extras.append(
                nn.Sequential(
                    *then(nn.Conv2d(channels, scaled(narrow, width), 1)),
                    *then(
                        nn.Conv2d(
                            scaled(narrow, width), scaled(wide, width), 3, stride, padding=padding
                        )
                    ),
                )
            )
            channels = scaled(wide, width)
        self.extras = nn.ModuleList(extras)
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                start_small(module)  # from inputs up to 255, maps become smaller with depth

    @property
    def vgg_convs(self) -> tuple[nn.Conv2d, ...]:
        """The 13 convolutions of VGG16, in its order."""
        parts = (*self.to_conv4_3.modules(), *self.to_fc7.modules())
        convs = [part for part in parts if isinstance(part, nn.Conv2d)]
        return tuple(convs[: sum(map(len, VGG_CONVS))])

    def to_conv5_3(
        self, planes: Float[Tensor, "batch in_channels height width"]
    ) -> Float[Tensor, "batch channels rows columns"]:
        """Compute the features of VGG16's last convolution."""
        maps: Tensor = self.to_conv4_3(planes)
        for layer in self.to_fc7[: self.num_to_conv5_3]:
            maps = layer(maps)
        return maps

    def forward(
        self, planes: Float[Tensor, "batch in_channels height width"]
    ) -> list[Float[Tensor, "batch _channels _rows _columns"]]:
        """Compute the six maps, the finest first."""
        conv4_3 = self.to_conv4_3(planes)
        maps = [self.norm(conv4_3), self.to_fc7(conv4_3)]
        for extra in self.extras:
            maps.append(extra(maps[-1]))
        return maps

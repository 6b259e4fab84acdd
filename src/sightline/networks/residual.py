"""Residual convolutional stream: maps of an image at falling resolutions."""

from collections.abc import Sequence

from jaxtyping import Float
from torch import Tensor, nn


class ConvNorm(nn.Sequential):
    """Convolution that keeps the size (or divides it by `stride`), BatchNorm, optional ReLU.

    Depthwise convolutions take longer on CPUs than dense ones. `momentum` is BatchNorm's.
    """

    def __init__(
        self,
        in_channels: int,
        out_channels: int,
        kernel_px: int = 3,
        stride: int = 1,
        *,
        relu: bool = True,
        momentum: float = 0.1,
    ) -> None:
        layers: list[nn.Module] = [
            nn.Conv2d(
                in_channels, out_channels, kernel_px, stride, padding=kernel_px // 2, bias=False
            ),
            nn.BatchNorm2d(out_channels, momentum=momentum),
        ]
        super().__init__(*layers, *[nn.ReLU(inplace=True)] * relu)


class ResidualBlock(nn.Module):
    """Two convolutions beside the identity: He et al. 2016, with the ReLU after the sum."""

    def __init__(self, channels: int, *, momentum: float = 0.1) -> None:
        super().__init__()
        self.first = ConvNorm(channels, channels, momentum=momentum)
        self.second = ConvNorm(channels, channels, relu=False, momentum=momentum)
        self.activate = nn.ReLU(inplace=True)

    def forward(
        self, maps: Float[Tensor, "batch channels rows columns"]
    ) -> Float[Tensor, "batch channels rows columns"]:
        """Compute maps of the same size and channels."""
        changed: Tensor = self.activate(maps + self.second(self.first(maps)))
        return changed


class ResidualStream(nn.Module):
    """Stem and four stages, each of which halves the maps, down to a stride of 32.

    Args:
        in_channels: Channels of the sensor's image.
        channels: Channels after the stem (stride 2) and the stages (4, 8, 16, 32).
        blocks: Number of residual blocks in each stage.
        pooling: Side in pixels of blocks for max pooling before the stem, whose first convolutions
            then keep the size. For images with few non-empty pixels.
        num_maps: Number of maps that are returned, of the smallest.
    """

    def __init__(
        self,
        in_channels: int,
        channels: Sequence[int],
        blocks: Sequence[int],
        pooling: int = 1,
        num_maps: int = 3,
    ) -> None:
        super().__init__()
        self.num_maps = num_maps
        self.pool = nn.MaxPool2d(pooling) if pooling > 1 else nn.Identity()
        stem_stride, first_stride = {1: (2, 2), 2: (1, 2), 4: (1, 1)}[pooling]
        self.stem = ConvNorm(in_channels, channels[0], stride=stem_stride)
        strides = (first_stride, 2, 2, 2)
        self.stages = nn.ModuleList(
            nn.Sequential(
                ConvNorm(before, count, stride=stride),
                *(ResidualBlock(count) for _ in range(number)),
            )
            for before, count, number, stride in zip(
                channels, channels[1:], blocks, strides, strict=False
            )
        )

    def forward(
        self, planes: Float[Tensor, "batch in_channels height width"]
    ) -> list[Float[Tensor, "batch _channels _rows _columns"]]:
        """Compute the last maps: three have strides 8, 16 and 32."""
        features = self.stem(self.pool(planes))
        maps = []
        for stage in self.stages:
            features = stage(features)
            maps.append(features)
        return maps[-self.num_maps :]

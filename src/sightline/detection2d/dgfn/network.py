"""Layers of the paper's network: VGG16 as SSD300 uses it, priors, SSD's head."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import torch
from jaxtyping import Float
from torch import Tensor, nn

from sightline.detection2d.config import CLASSES, DgfnConfig, scaled
from sightline.detection2d.fusion import GatedFusion, HeadOutput


def start_small(conv: nn.Conv2d) -> nn.Conv2d:
    """Initialise weights by Glorot and Bengio 2010 (Xavier), and biases by 0."""
    nn.init.xavier_uniform_(conv.weight)
    if conv.bias is not None:
        nn.init.zeros_(conv.bias)
    return conv


_RGB_MEANS = (0.48235, 0.45882, 0.40784)  # ImageNet's, subtracted in VGG16's training


class VggInput(nn.Module):
    """Images of both sensors, given in [0, 1], scaled to the range of VGG16's pretraining.

    Planes are 255 times as large, RGB minus its means.

    Kim et al. 2018 do not specify this. The LiDAR's image is not shifted, so that pixels without a
    point are 0; a black camera image is -mean, as from a dead camera.
    """

    camera_planes, lidar_planes = 3, 3
    means: Tensor

    def __init__(self) -> None:
        super().__init__()
        means = torch.tensor(_RGB_MEANS)[:, None, None]
        self.register_buffer("means", means, persistent=False)

    def camera(
        self, image: Float[Tensor, "batch 3 height width"]
    ) -> Float[Tensor, "batch 3 height width"]:
        """Convert RGB in [0, 1] to planes."""
        return 255 * (image - self.means)

    def lidar(
        self, image: Float[Tensor, "batch 3 height width"]
    ) -> Float[Tensor, "batch 3 height width"]:
        """Convert depth, height and intensity in [0, 1] to planes."""
        return 255 * image


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
            for out_channels in group:
                layers += then(nn.Conv2d(channels, scaled(out_channels, width), 3, padding=1))
                channels = scaled(out_channels, width)
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


_CENTER_VARIANCE, _SIZE_VARIANCE = 0.1, 0.2  # SSD's divisors of the offsets
_LARGEST_LOG_SIZE = math.log(1000.0)  # keeps boxes of untrained networks finite


def prior_shapes(
    sizes_px: Sequence[float], ratios: Sequence[Sequence[float]]
) -> list[list[tuple[float, float]]]:
    """Compute width and height [px] of each prior of each map: Liu et al. 2016, section 2.2.

    The order is that of SSD's own program: the square of the map's size, the square of the
    geometric mean with the next size, then each ratio lying and upright. Sizes stay those of
    SSD300, in pixels: scaled to an image three times as wide as high, upright priors would be lost,
    and pedestrians with them.
    """
    shapes = []
    for size, following, map_ratios in zip(sizes_px, sizes_px[1:], ratios, strict=False):
        mean = math.sqrt(size * following)
        boxes = [(size, size), (mean, mean)]
        for ratio in map_ratios:
            root = math.sqrt(ratio)
            boxes += [(size * root, size / root), (size / root, size * root)]
        shapes.append(boxes)
    return shapes


def make_priors(
    shapes: Sequence[tuple[float, float]],
    rows: int,
    columns: int,
    image_size: tuple[int, int],
    like: Tensor,
) -> Float[Tensor, "places 4"]:
    """Make centre x, y, width, height [px] of the priors of a map: row by row, then by shape.

    The map's cells divide the image evenly. Priors are clipped to it (at the centres of its
    outermost pixels, as labels are).

    Args:
        shapes: Width, height [px] of the priors of each cell.
        rows: Number of rows of the map.
        columns: Number of columns of the map.
        image_size: Height, width [px] of the network's input.
        like: Tensor with the result's device and type.
    """
    height, width = image_size
    y = (torch.arange(rows, device=like.device) + 0.5) * (height / rows) - 0.5
    x = (torch.arange(columns, device=like.device) + 0.5) * (width / columns) - 0.5
    half = torch.tensor(shapes, device=like.device) / 2
    low_x = (x[None, :, None] - half[:, 0]).clamp(min=0).expand(rows, -1, -1)
    high_x = (x[None, :, None] + half[:, 0]).clamp(max=width - 1).expand(rows, -1, -1)
    low_y = (y[:, None, None] - half[:, 1]).clamp(min=0).expand(-1, columns, -1)
    high_y = (y[:, None, None] + half[:, 1]).clamp(max=height - 1).expand(-1, columns, -1)
    bounds = torch.stack(
        ((low_x + high_x) / 2, (low_y + high_y) / 2, high_x - low_x, high_y - low_y), dim=-1
    )
    return bounds.reshape(-1, 4).to(like.dtype)


def corners_of(places: Float[Tensor, "*batch 4"]) -> Float[Tensor, "*batch 4"]:
    """Convert centres and sizes to x_min, y_min, x_max, y_max."""
    centers, sizes = places[..., :2], places[..., 2:]
    return torch.cat((centers - sizes / 2, centers + sizes / 2), dim=-1)


def encode_boxes(
    boxes: Float[Tensor, "num 4"], places: Float[Tensor, "num 4"]
) -> Float[Tensor, "num 4"]:
    """Encode boxes (corners) as offsets from priors (centres and sizes), the network's targets.

    Liu et al. 2016, eq. 2, divided by SSD's variances 0.1 and 0.2.
    """
    sizes = (boxes[:, 2:] - boxes[:, :2]).clamp(min=1e-3)
    centers = (boxes[:, :2] + boxes[:, 2:]) / 2
    moved = (centers - places[:, :2]) / places[:, 2:] / _CENTER_VARIANCE
    return torch.cat((moved, (sizes / places[:, 2:]).log() / _SIZE_VARIANCE), dim=1)


def decode_boxes(
    offsets: Float[Tensor, "batch places 4"], places: Float[Tensor, "places 4"]
) -> Float[Tensor, "batch places 4"]:
    """Decode offsets to corners [px]. Sides are at most 1000 times the prior's."""
    centers = places[:, :2] + offsets[..., :2] * _CENTER_VARIANCE * places[:, 2:]
    sizes = (offsets[..., 2:] * _SIZE_VARIANCE).clamp(max=_LARGEST_LOG_SIZE).exp() * places[:, 2:]
    return torch.cat((centers - sizes / 2, centers + sizes / 2), dim=-1)


class SsdHead(nn.Module):
    """3x3 convolution on each map for its priors' classes and offsets: Liu et al. 2016, sec. 2.1.

    Class 0 is the background.

    Args:
        channels: Channels of each map, the finest first.
        config: Shapes of the priors.
    """

    def __init__(self, channels: Sequence[int], config: DgfnConfig) -> None:
        super().__init__()
        self.shapes = prior_shapes(config.prior_sizes_px, config.prior_ratios)
        self.values = len(CLASSES) + 1 + 4  # values of each prior
        self.convs = nn.ModuleList(
            start_small(nn.Conv2d(count, len(shapes) * self.values, 3, padding=1))
            for count, shapes in zip(channels, self.shapes, strict=True)
        )

    def forward(
        self,
        maps: Sequence[Float[Tensor, "batch _channels _rows _columns"]],
        image_size: tuple[int, int],
    ) -> HeadOutput:
        """Compute the outputs for the maps of an image of (height, width) [px]."""
        values, places = [], []
        for conv, shapes, features in zip(self.convs, self.shapes, maps, strict=True):
            rows, columns = features.shape[-2:]
            predicted = conv(features).float().permute(0, 2, 3, 1)
            values.append(
                predicted.reshape(predicted.shape[0], rows * columns * len(shapes), self.values)
            )
            places.append(make_priors(shapes, rows, columns, image_size, values[-1]))
        class_logits, box_logits = torch.split(
            torch.cat(values, dim=1), [self.values - 4, 4], dim=2
        )
        return HeadOutput(class_logits, box_logits, torch.cat(places))

    def decode(
        self, output: HeadOutput
    ) -> tuple[Float[Tensor, "batch places classes"], Float[Tensor, "batch places 4"]]:
        """Compute class probabilities without the background, and boxes (corners, px)."""
        scores = output.class_logits.softmax(dim=2)[..., 1:]
        return scores, decode_boxes(output.box_logits, output.places)


@dataclass(frozen=True)
class DgfnDesign:
    """Design of the paper: VGG16's layers, and SSD's heads."""

    config: DgfnConfig
    width: float
    stride: int = 1
    smallest_px: int = VggStream.smallest_px

    def prepare(self) -> VggInput:
        """Make a `VggInput`."""
        return VggInput()

    def stream(self, sensor: str, planes: int) -> VggStream:
        """Make a stream; all are alike."""
        del sensor
        config = self.config
        return VggStream(planes, self.width, config.l2_norm_scale, batch_norm=config.batch_norm)

    def channels(self, sensor: str) -> tuple[int, ...]:
        """Channels of the six maps."""
        del sensor
        return tuple(scaled(count, self.width) for count in MAP_CHANNELS)

    def fusions(self, *, gated: bool) -> list[GatedFusion]:
        """Make fusions; joint maps have as many channels as each sensor's: eq. 9."""
        return [
            GatedFusion(
                (count, count),
                nn.Sequential(start_small(nn.Conv2d(2 * count, count, 1)), nn.ReLU()),
                gated=gated,
            )
            for count in self.channels("camera")
        ]

    def head(self, seen: str) -> SsdHead:
        """Make a head; all are alike."""
        return SsdHead(self.channels(seen), self.config)

    def auxiliary_head(self, sensor: str) -> None:
        """None: the paper has no auxiliary heads."""
        del sensor

"""Layers of the compact detector: its input, and an anchor-free head on residual streams."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from sightline.detection2d.config import CLASSES, CompactConfig, scaled
from sightline.detection2d.fusion import GatedFusion, HeadOutput
from sightline.networks.residual import ConvNorm, ResidualStream


class CompactInput(nn.Module):
    """Images of both sensors, centred at zero; all zero if a sensor is missing."""

    camera_planes, lidar_planes = 3, 4

    def camera(
        self, image: Float[Tensor, "batch 3 height width"]
    ) -> Float[Tensor, "batch 3 height width"]:
        """Convert RGB in [0, 1] to planes."""
        is_present = (image.amax(dim=(1, 2, 3), keepdim=True) > 0).to(image.dtype)
        return 4 * (image - 0.5) * is_present

    def lidar(
        self, image: Float[Tensor, "batch 3 height width"]
    ) -> Float[Tensor, "batch 4 height width"]:
        """Convert depth, height and intensity in [0, 1] to planes, and add a mask of points.

        All values are largest for near, low and dark points, so that the maximum is a useful
        summary of several pixels.
        """
        has_point = (image.amax(dim=1, keepdim=True) > 0).to(image.dtype)
        return torch.cat((2 * image, has_point), dim=1)


MAP_STRIDES: Final = (8, 16, 32)
"""Strides of a stream's maps."""


_INITIAL_SCORE = 0.01  # for every class and cell: Lin et al. 2017 (focal loss), section 3.3
_INITIAL_SLOPE = 0.3  # initial slope of the distances' log-likelihoods: boxes start small


class PyramidNeck(nn.Module):
    """Exchange of features between maps of three scales: from coarse to fine, then back.

    The two paths of PANet (Liu et al. 2018), with sums and few convolutions.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.down_16, self.down_8 = ConvNorm(channels, channels), ConvNorm(channels, channels)
        self.shrink_8 = ConvNorm(channels, channels, stride=2)
        self.shrink_16 = ConvNorm(channels, channels, stride=2)

    def forward(
        self, maps: Sequence[Float[Tensor, "batch channels _rows _columns"]]
    ) -> list[Float[Tensor, "batch channels _rows _columns"]]:
        """Exchange features between maps of strides 8, 16 and 32; their sizes halve exactly."""
        fine, middle, coarse = maps
        middle = self.down_16(middle + F.interpolate(coarse, scale_factor=2.0))
        fine = self.down_8(fine + F.interpolate(middle, scale_factor=2.0))
        middle = middle + self.shrink_8(fine)
        return [fine, middle, coarse + self.shrink_16(middle)]


class AlignedHead(nn.Module):
    """Anchor-free head: scores and boxes of every cell, with the same weights for all scales.

    A box is given by four distances from the cell's centre, each as a distribution over whole
    multiples of the stride (Li et al. 2020, generalized focal loss, section 3.2).

    Args:
        in_channels: Channels of the input maps.
        channels: Channels inside.
        convs: Number of 3x3 convolutions before the prediction.
        bins: Largest distance, in strides.
        neck: Whether scales exchange features first.
    """

    def __init__(
        self, in_channels: Sequence[int], channels: int, *, convs: int, bins: int, neck: bool
    ) -> None:
        super().__init__()
        self.bins = bins
        self.laterals = nn.ModuleList(
            nn.Identity() if count == channels else ConvNorm(count, channels, 1)
            for count in in_channels
        )
        self.neck = PyramidNeck(channels) if neck else None
        self.tower = nn.Sequential(*(ConvNorm(channels, channels) for _ in range(convs)))
        self.classify = nn.Conv2d(channels, len(CLASSES), 1)
        self.measure = nn.Conv2d(channels, 4 * (bins + 1), 1)
        nn.init.normal_(self.classify.weight, std=0.01)
        nn.init.normal_(self.measure.weight, std=0.01)
        assert self.classify.bias is not None, "made with one"
        assert self.measure.bias is not None, "made with one"
        nn.init.constant_(self.classify.bias, -math.log(1 / _INITIAL_SCORE - 1))
        with torch.no_grad():
            self.measure.bias.copy_(-_INITIAL_SLOPE * torch.arange(bins + 1).repeat(4))

    def start_at_nothing(self) -> None:
        """Set the output to 0, so that adding it to other heads' outputs changes nothing."""
        for last in (self.classify, self.measure):
            for parameter in last.parameters():
                nn.init.zeros_(parameter)

    def forward(
        self,
        maps: Sequence[Float[Tensor, "batch _channels _rows _columns"]],
        image_size: tuple[int, int],
    ) -> HeadOutput:
        """Run the head on maps of strides 8, 16 and 32 of an image of (height, width) [px]."""
        del image_size  # given by the strides
        features = [lateral(each) for lateral, each in zip(self.laterals, maps, strict=True)]
        if self.neck is not None:
            features = self.neck(features)
        classes, boxes, places = [], [], []
        for stride, each in zip(MAP_STRIDES, features, strict=True):
            seen = self.tower(each)
            classes.append(self.classify(seen).float().flatten(2))
            boxes.append(self.measure(seen).float().flatten(2))
            places.append(cells(seen.shape[2], seen.shape[3], stride, classes[-1]))
        return HeadOutput(
            class_logits=torch.cat(classes, dim=2).transpose(1, 2),
            box_logits=torch.cat(boxes, dim=2).transpose(1, 2),
            places=torch.cat(places),
        )

    def decode(
        self, output: HeadOutput
    ) -> tuple[Float[Tensor, "batch places classes"], Float[Tensor, "batch places 4"]]:
        """Compute class probabilities and boxes (corners, px)."""
        return output.class_logits.sigmoid(), decode_distances(output)


def cells(rows: int, columns: int, stride: int, like: Tensor) -> Float[Tensor, "cells 4"]:
    """Compute middle x, y, width and height [px] of a map's cells, row by row."""
    y = (torch.arange(rows, device=like.device) + 0.5) * stride - 0.5
    x = (torch.arange(columns, device=like.device) + 0.5) * stride - 0.5
    middles = torch.stack((x.expand(rows, -1), y[:, None].expand(-1, columns)), dim=2)
    middles = middles.reshape(-1, 2).to(like.dtype)
    return torch.cat((middles, torch.full_like(middles, stride)), dim=1)


def decode_distances(output: HeadOutput) -> Float[Tensor, "batch places 4"]:
    """Compute box corners [px] from the means of the distance distributions."""
    batch, number, values = output.box_logits.shape
    shares = output.box_logits.reshape(batch, number, 4, values // 4).softmax(dim=3)
    steps = torch.arange(values // 4, device=shares.device, dtype=shares.dtype)
    distances = (shares * steps).sum(dim=3) * output.places[:, 2:].repeat(1, 2)
    middles = output.places[:, :2]
    return torch.cat((middles - distances[..., :2], middles + distances[..., 2:]), dim=2)


@dataclass(frozen=True)
class CompactDesign:
    """Light design: residual streams, and anchor-free heads."""

    config: CompactConfig
    width: float
    stride: int = 32
    smallest_px: int = 32

    def prepare(self) -> CompactInput:
        """Make a `CompactInput`."""
        return CompactInput()

    def stream(self, sensor: str, planes: int) -> ResidualStream:
        """Make a stream; the LiDAR's own stream pools its image."""
        config = self.config
        settings = config.lidar if sensor == "lidar" else config.camera
        pooling = config.lidar_pooling if sensor == "lidar" else 1
        return ResidualStream(planes, self._all_channels(sensor), settings.blocks, pooling)

    def channels(self, sensor: str) -> tuple[int, ...]:
        """Channels of the maps of strides 8, 16 and 32."""
        return self._all_channels(sensor)[2:]

    def fusions(self, *, gated: bool) -> list[GatedFusion]:
        """Make fusions; joint maps have the head's channels."""
        joint = scaled(self.config.head_channels, self.width)
        return [
            GatedFusion(
                both, ConvNorm(sum(both), joint, 1), gated=gated, groups=self.config.gate_groups
            )
            for both in zip(self.channels("camera"), self.channels("lidar"), strict=True)
        ]

    def head(self, seen: str) -> AlignedHead:
        """Make a head with a neck."""
        channels = scaled(self.config.head_channels, self.width)
        given: Sequence[int] = (channels,) * 3 if seen == "joint" else self.channels(seen)
        return AlignedHead(
            given, channels, convs=self.config.head_convs, bins=self.config.bins, neck=True
        )

    def auxiliary_head(self, sensor: str) -> AlignedHead | None:
        """Make a single stream's head; for training alone a small one: the stream does the work."""
        if self.config.own_heads:
            return self.head(sensor)
        if not self.config.auxiliary:
            return None
        channels = scaled(self.config.head_channels, self.width)
        given = self.channels(sensor)
        return AlignedHead(given, channels, convs=1, bins=self.config.bins, neck=False)

    def _all_channels(self, sensor: str) -> tuple[int, ...]:
        settings = self.config.lidar if sensor == "lidar" else self.config.camera
        return tuple(scaled(count, self.width) for count in settings.channels)

"""Parts of the two detector designs."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from torch import nn

from sightline.detection2d.aligned_head import AlignedHead
from sightline.detection2d.config import CompactConfig, Detection2DConfig, DgfnConfig, scaled
from sightline.detection2d.gated_fusion import GatedFusion
from sightline.detection2d.initialization import start_small
from sightline.detection2d.inputs import CompactInput, VggInput
from sightline.detection2d.residual_stream import ConvNorm, ResidualStream
from sightline.detection2d.ssd_head import SsdHead
from sightline.detection2d.vgg_stream import MAP_CHANNELS, VggStream


@runtime_checkable  # for beartype, which checks arguments under pytest
class Design(Protocol):
    """Interface for the parts of a `Detector`."""

    @property
    def stride(self) -> int:
        """Divisor of image heights and widths."""
        ...

    @property
    def smallest_px(self) -> int:
        """Smallest height and width of images."""
        ...

    def prepare(self) -> CompactInput | VggInput:
        """Make the module that prepares images."""
        ...

    def stream(self, sensor: str, planes: int) -> nn.Module:
        """Make the stream of the camera, the LiDAR or both."""
        ...

    def channels(self, sensor: str) -> tuple[int, ...]:
        """Channels of the maps from such a stream."""
        ...

    def fusions(self, *, gated: bool) -> list[GatedFusion]:
        """Make one fusion for each map."""
        ...

    def head(self, seen: str) -> SsdHead | AlignedHead:
        """Make the head for one sensor's maps, for those of both, or for the joint maps."""
        ...

    def auxiliary_head(self, sensor: str) -> AlignedHead | None:
        """Make the head for a stream's own maps."""
        ...


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


def design_of(config: Detection2DConfig) -> Design:
    """Select the design by the settings."""
    if config.compact is not None:
        return CompactDesign(config.compact, config.width)
    assert config.dgfn is not None, "settings name one of them"
    return DgfnDesign(config.dgfn, config.width)

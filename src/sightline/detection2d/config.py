"""Settings of the 2D detectors. The defaults are the system of Kim et al. 2018 as we read it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, Literal, SupportsFloat, get_args

from sightline.data.settings import IN_TRAINING_ALONE
from sightline.geometry.kitti_mount import KITTI_LIDAR_HEIGHT_M

CLASSES: Final = ("Car", "Pedestrian", "Cyclist")
"""What is detected, in the order of the networks' outputs."""

Fusion = Literal["gated", "ones", "early", "late", "camera", "lidar"]
"""How the sensors meet. `gated`: feature maps weighted by learned gates; `ones`: the same network
with all weights 1; `early`: one network on the channels of both; `late`: one detector a sensor,
their boxes suppressed together; `camera`, `lidar`: one sensor alone."""

LidarPooling = Literal[1, 2, 4]
"""Side [px] of the blocks that a LiDAR's image may be reduced to the maxima of."""

_LARGEST_WIDTH = 8.0
_LARGEST_PX = 8192
_MOST_PX = 2**23  # as many as a picture of 4K has
_SMALLEST_PRIOR_PX = 0.1
_LARGEST_RATIO = 100.0
_MOST_DETECTIONS = 10_000


def check_range(
    name: str, value: SupportsFloat, lowest: SupportsFloat, highest: SupportsFloat
) -> None:
    """Refuses a number of a setting that is out of range.

    Raises:
        ValueError: It is, or it is NaN.
    """
    if not float(lowest) <= float(value) <= float(highest):
        raise ValueError(f"{name} must be from {lowest} to {highest}, got {value}")


def check_choice(name: str, value: object, choices: Sequence[object]) -> None:
    """Refuses a setting that is none of its choices.

    Raises:
        ValueError: It is none.
    """
    if value not in choices:
        raise ValueError(f"{name} must be one of {', '.join(map(str, choices))}, got {value!r}")


def scaled(channels: int, width: float) -> int:
    """Channels of a layer in a network of another width: at least one."""
    return max(round(channels * width), 1)


@dataclass(frozen=True, kw_only=True)
class InputConfig:
    """What a network sees of a frame: for training, scoring and use alike."""

    size: tuple[int, int] | None = (375, 1242)
    """Height, width [px] that frames are resized to. None: they keep their proportions."""
    scale: float = 1.0
    """Factor on the sides of frames that keep their proportions."""
    longest_focal_px: float = 750.0
    """Frames that keep their proportions are shrunk first where the camera's focal length is longer
    than this: a car is as many pixels wide as at the same distance from KITTI's cameras, whose
    focal lengths are up to 722 px."""
    height_offset_m: float = KITTI_LIDAR_HEIGHT_M
    """Added to the height of LiDAR points; 0 is the letter of Kim et al. 2018, eq. 3."""

    def __post_init__(self) -> None:
        """Checks the ranges."""
        if self.size is not None and not all(0 < side <= _LARGEST_PX for side in self.size):
            raise ValueError(f"input.size must be from 1 to {_LARGEST_PX} px, got {self.size}")
        if self.size is not None and math.prod(self.size) > _MOST_PX:
            raise ValueError(f"input.size must have up to {_MOST_PX} pixels, got {self.size}")
        check_range("input.scale", self.scale, 0.01, 4)
        check_range("input.longest_focal_px", self.longest_focal_px, 1, 1e6)
        check_range("input.height_offset_m", self.height_offset_m, -100, 100)


@dataclass(frozen=True, kw_only=True)
class DgfnConfig:
    """Two VGG16 streams of SSD300's layout: Kim et al. 2018, with Liu et al. 2016 (SSD).

    "Robust Camera Lidar Sensor Fusion Via Deep Gated Information Fusion Network".
    """

    prior_sizes_px: tuple[float, ...] = (30.0, 60.0, 111.0, 162.0, 213.0, 264.0, 315.0)
    """Sides of the square priors of each of the six maps, and one more: the second square of each
    map is the geometric mean of its size and the next. Pixels of the network's input."""
    prior_ratios: tuple[tuple[float, ...], ...] = (
        (2.0,),
        (2.0, 3.0),
        (2.0, 3.0),
        (2.0, 3.0),
        (2.0,),
        (2.0,),
    )
    """Width over height of each map's other priors; each comes upright and lying."""
    l2_norm_scale: float = 20.0
    """To which the features of conv4_3 are scaled at first (Liu et al. 2016, section 3.1)."""
    batch_norm: bool = False
    """Whether the convolutions of the streams are normalised. Without VGG16's weights, a short
    training of the paper's own layers hardly leaves its start."""

    def __post_init__(self) -> None:
        """Checks the numbers of the priors."""
        num_maps = 6
        if len(self.prior_sizes_px) != num_maps + 1 or len(self.prior_ratios) != num_maps:
            raise ValueError(
                f"dgfn has {num_maps} maps: expected {num_maps + 1} prior_sizes_px and {num_maps} "
                f"prior_ratios, got {len(self.prior_sizes_px)} and {len(self.prior_ratios)}"
            )
        for size_px in self.prior_sizes_px:
            check_range("dgfn.prior_sizes_px", size_px, _SMALLEST_PRIOR_PX, _LARGEST_PX)
        for ratio in (each for map_ in self.prior_ratios for each in map_):
            check_range("dgfn.prior_ratios", ratio, 1 / _LARGEST_RATIO, _LARGEST_RATIO)


@dataclass(frozen=True, kw_only=True)
class StreamConfig:
    """One sensor's stream of the compact detector."""

    channels: tuple[int, int, int, int, int]
    """Of the maps of strides 2, 4, 8, 16 and 32."""
    blocks: tuple[int, int, int, int]
    """Residual blocks at strides 4, 8, 16 and 32."""

    def __post_init__(self) -> None:
        """Checks the ranges."""
        for count in self.channels:
            check_range("channels of a stream", count, 1, 4096)
        for count in self.blocks:
            check_range("blocks of a stream", count, 0, 64)


@dataclass(frozen=True, kw_only=True)
class CompactConfig:
    """Two light residual streams, fused at strides 8, 16 and 32, and an anchor-free head."""

    camera: StreamConfig = StreamConfig(channels=(16, 24, 48, 96, 160), blocks=(1, 1, 2, 2))
    """Also the one stream of early fusion."""
    lidar: StreamConfig = StreamConfig(channels=(16, 24, 32, 64, 96), blocks=(0, 1, 1, 1))
    """Smaller, as it has less to distinguish."""
    lidar_pooling: LidarPooling = 2
    """The LiDAR's image, most of which is empty, is reduced to the maxima of so many pixels
    squared first. Not in early fusion."""
    gate_groups: int = 1
    """Groups of channels of each sensor that have a gate of their own."""
    head_channels: int = 48
    """Of the fused maps, the neck and the head."""
    head_convs: int = 2
    """3x3 convolutions of the head before its prediction."""
    bins: int = 16
    """Largest distance of a side from the centre of its cell, in strides."""
    auxiliary: bool = field(default=True, metadata=IN_TRAINING_ALONE)
    """Whether each stream has a head of its own in training, so that one sensor does not starve the
    other. It costs nothing afterwards."""
    own_heads: bool = False
    """Whether each stream has a whole head of its own, in use too: its answers are mixed with the
    joint head's as the gates say."""

    def __post_init__(self) -> None:
        """Checks the ranges."""
        check_choice("compact.lidar_pooling", self.lidar_pooling, get_args(LidarPooling))
        for name, highest in (("gate_groups", 64), ("head_channels", 4096), ("bins", 256)):
            check_range(f"compact.{name}", getattr(self, name), 1, highest)
        check_range("compact.head_convs", self.head_convs, 0, 64)


@dataclass(frozen=True, kw_only=True)
class PostprocessConfig:
    """How boxes become detections."""

    min_score: float = 0.01
    """Boxes of this score or a lower one are left out."""
    nms_iou: float = 0.45
    """Of two boxes of a class that overlap more, the one of the higher score stays."""
    max_detections: int = 200
    """Of an image; those of the highest scores."""

    def __post_init__(self) -> None:
        """Checks the ranges."""
        check_range("postprocess.min_score", self.min_score, 0, 1)
        check_range("postprocess.nms_iou", self.nms_iou, 0, 1)
        check_range("postprocess.max_detections", self.max_detections, 1, _MOST_DETECTIONS)


@dataclass(frozen=True, kw_only=True)
class Detection2DConfig:
    """A 2D detector."""

    fusion: Fusion = "gated"
    """How the sensors meet."""
    width: float = 1.0
    """Factor on the channels of all layers."""
    input: InputConfig = InputConfig()
    """What it sees of a frame."""
    dgfn: DgfnConfig | None = DgfnConfig()
    """The network of the paper; None: another."""
    compact: CompactConfig | None = None
    """A light network; set dgfn to null with it."""
    postprocess: PostprocessConfig = PostprocessConfig()
    """How its boxes become detections."""

    def __post_init__(self) -> None:
        """Checks the ranges, and that one design is named."""
        check_choice("fusion", self.fusion, get_args(Fusion))
        if not 0 < self.width <= _LARGEST_WIDTH:
            raise ValueError(f"width must be in (0, {_LARGEST_WIDTH}], got {self.width}")
        if (self.dgfn is None) == (self.compact is None):
            raise ValueError(
                "a detector is dgfn or compact: set one of them, and the other to null"
            )

"""Settings of the 2D detectors: defaults as shipped, and `PAPER`, those of Kim et al. 2018."""

import math
from dataclasses import dataclass, field
from typing import Final, Literal

from sightline.files.settings import TRAINING_ONLY
from sightline.geometry.choices import check_choices
from sightline.geometry.kitti_mount import KITTI_LIDAR_HEIGHT_M
from sightline.geometry.ranges import check_range

CLASSES: Final = ("Car", "Pedestrian", "Cyclist")
"""Detected classes, in the order of the networks' outputs."""

Fusion = Literal["gated", "ones", "early", "late", "camera", "lidar"]
"""Fusion of the sensors. `gated`: feature maps weighted by learned gates; `ones`: the same network
with all weights 1; `early`: one network on the channels of both; `late`: one detector for each
sensor, their boxes suppressed together; `camera`, `lidar`: one sensor alone."""

LidarPooling = Literal[1, 2, 4]
"""Side [px] of the blocks for max pooling of a LiDAR's image."""

_LARGEST_WIDTH = 8.0
_LARGEST_PX = 8192
_MAX_PX = 2**23  # about a 4K picture
_SMALLEST_PRIOR_PX = 0.1
_LARGEST_RATIO = 100.0
_LARGEST_L2_NORM_SCALE = 1000.0
_MAX_DETECTIONS = 10_000


def scaled(channels: int, width: float) -> int:
    """Scale a layer's channels to another network width; at least one channel remains."""
    return max(round(channels * width), 1)


@dataclass(frozen=True, kw_only=True)
class InputConfig:
    """Preparation of frames for a network: the same for training, scoring and use."""

    size: tuple[int, int] | None = None
    """Height, width [px] that frames are resized to. None: they keep their proportions."""
    scale: float = 1.0
    """Factor on the sides of frames that keep their proportions."""
    longest_focal_px: float = 750.0
    """Longest focal length of frames that keep their proportions; others are shrunk first. A car
    then has the same width in pixels as at the same distance from KITTI's cameras, whose focal
    lengths are up to 722 px."""
    rows_above_horizon: int = 205
    """Rows above the horizon that are searched in use, of frames that keep their proportions; the
    scale applies to them, too."""
    rows_below_horizon: int = 235
    """Rows below the horizon that are searched in use. Frames with no more rows than both together
    are searched as a whole, like KITTI's; see `detection2d.views` for others."""
    height_offset_m: float = KITTI_LIDAR_HEIGHT_M
    """Height added to LiDAR points; 0 follows Kim et al. 2018, eq. 3, exactly."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        if self.size is not None and not all(0 < side <= _LARGEST_PX for side in self.size):
            raise ValueError(f"input.size must be from 1 to {_LARGEST_PX} px, got {self.size}")
        if self.size is not None and math.prod(self.size) > _MAX_PX:
            raise ValueError(f"input.size must have up to {_MAX_PX} pixels, got {self.size}")
        check_range("input.scale", self.scale, 0.01, 4)
        check_range("input.longest_focal_px", self.longest_focal_px, 1, 1e6)
        check_range("input.rows_above_horizon", self.rows_above_horizon, 32, _LARGEST_PX)
        check_range("input.rows_below_horizon", self.rows_below_horizon, 32, _LARGEST_PX)
        check_range("input.height_offset_m", self.height_offset_m, -100, 100)


@dataclass(frozen=True, kw_only=True)
class DgfnConfig:
    """Two VGG16 streams of SSD300's layout: Kim et al. 2018, with Liu et al. 2016 (SSD).

    "Robust Camera Lidar Sensor Fusion Via Deep Gated Information Fusion Network".
    """

    prior_sizes_px: tuple[float, ...] = (30.0, 60.0, 111.0, 162.0, 213.0, 264.0, 315.0)
    """Side of the square prior of each of the six maps, and one more: the second square of each map
    is the geometric mean of its size and the next. Pixels of the network's input."""
    prior_ratios: tuple[tuple[float, ...], ...] = (
        (2.0,),
        (2.0, 3.0),
        (2.0, 3.0),
        (2.0, 3.0),
        (2.0,),
        (2.0,),
    )
    """Aspect ratios (width / height) of each map's other priors, each used upright and lying."""
    l2_norm_scale: float = 20.0
    """Initial scale of the features of conv4_3 (Liu et al. 2016, section 3.1)."""
    batch_norm: bool = False
    """Whether the streams' convolutions have batch normalisation, which a training from scratch
    needs. It is folded into them in the weights that a training leaves: those are the paper's."""

    def __post_init__(self) -> None:
        """Check the numbers of the priors."""
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
        check_range("dgfn.l2_norm_scale", self.l2_norm_scale, 0, _LARGEST_L2_NORM_SCALE)


@dataclass(frozen=True, kw_only=True)
class StreamConfig:
    """One sensor's stream of the compact detector."""

    channels: tuple[int, int, int, int, int]
    """Channels of the maps of strides 2, 4, 8, 16 and 32."""
    blocks: tuple[int, int, int, int]
    """Number of residual blocks at strides 4, 8, 16 and 32."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        for count in self.channels:
            check_range("channels of a stream", count, 1, 4096)
        for count in self.blocks:
            check_range("blocks of a stream", count, 0, 64)


@dataclass(frozen=True, kw_only=True)
class CompactConfig:
    """Two light residual streams, fused at strides 8, 16 and 32, and an anchor-free head."""

    camera: StreamConfig = StreamConfig(channels=(16, 24, 48, 96, 160), blocks=(1, 1, 2, 2))
    """Camera stream; also the one stream of early fusion."""
    lidar: StreamConfig = StreamConfig(channels=(16, 24, 32, 64, 96), blocks=(0, 1, 1, 1))
    """LiDAR stream; smaller, as it has less to distinguish."""
    lidar_pooling: LidarPooling = 2
    """Side in pixels of the blocks for max pooling of the LiDAR's image, which is mostly empty. Not
    used in early fusion."""
    gate_groups: int = 1
    """Number of channel groups of each sensor with a gate of their own."""
    head_channels: int = 48
    """Channels of the fused maps, the neck and the head."""
    head_convs: int = 2
    """Number of 3x3 convolutions of the head before its prediction."""
    bins: int = 16
    """Largest distance of a side from the centre of its cell, in strides."""
    auxiliary: bool = field(default=True, metadata=TRAINING_ONLY)
    """Whether each stream has a head of its own in training, so that no sensor is neglected. It has
    no cost at inference."""
    own_heads: bool = False
    """Whether each stream also has a full head of its own at inference; the gates mix its output
    with the joint head's."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        check_choices(self, "compact.")
        for name, highest in (("gate_groups", 64), ("head_channels", 4096), ("bins", 256)):
            check_range(f"compact.{name}", getattr(self, name), 1, highest)
        check_range("compact.head_convs", self.head_convs, 0, 64)


@dataclass(frozen=True, kw_only=True)
class PostprocessConfig:
    """Settings that turn boxes into detections."""

    min_score: float = 0.02
    """Score up to which boxes are removed."""
    nms_iou: float = 0.6
    """IoU of two boxes of a class beyond which the one with the lower score is removed."""
    max_detections: int = 100
    """Largest number of detections in an image, by score."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        check_range("postprocess.min_score", self.min_score, 0, 1)
        check_range("postprocess.nms_iou", self.nms_iou, 0, 1)
        check_range("postprocess.max_detections", self.max_detections, 1, _MAX_DETECTIONS)


@dataclass(frozen=True, kw_only=True)
class Detection2DConfig:
    """Settings of a 2D detector."""

    fusion: Fusion = "gated"
    """Fusion of the sensors."""
    width: float = 1.0
    """Factor on the channels of all layers."""
    input: InputConfig = InputConfig()
    """Preparation of frames."""
    dgfn: DgfnConfig | None = None
    """Network of the paper; set compact to null with it."""
    compact: CompactConfig | None = CompactConfig()
    """Light network; None: another network."""
    postprocess: PostprocessConfig = PostprocessConfig()
    """Settings that turn boxes into detections."""

    def __post_init__(self) -> None:
        """Check the ranges, and that exactly one design is set."""
        check_choices(self)
        if not 0 < self.width <= _LARGEST_WIDTH:
            raise ValueError(f"width must be in (0, {_LARGEST_WIDTH}], got {self.width}")
        if (self.dgfn is None) == (self.compact is None):
            raise ValueError(
                "a detector is dgfn or compact: set one of them, and the other to null"
            )


PAPER: Final = Detection2DConfig(
    input=InputConfig(size=(375, 1242)),
    dgfn=DgfnConfig(),
    compact=None,
    postprocess=PostprocessConfig(min_score=0.01, nms_iou=0.45, max_detections=200),
)
"""Settings of Kim et al. 2018, by our reading."""

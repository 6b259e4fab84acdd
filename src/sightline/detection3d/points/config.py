"""Settings of the design on points; defaults from Shi et al. 2019 (PointRCNN)."""

import math
from dataclasses import dataclass, field
from typing import Final

from sightline.detection3d.checks import (
    MAX_NUMBERS,
    check_different,
    check_numbers,
    check_widths,
)
from sightline.detection3d.classes import CAR, RoadUserClass
from sightline.geometry.ranges import check_range

_MAX_CENTERS = 2**16
_MAX_ROI_POINTS = 2**14
_MAX_PAIRS = 2**25  # pairs of boxes for the IoU, which takes a few seconds
_LARGEST_RADIUS_M = 1000.0
_LARGEST_MARGIN_M = 100.0


@dataclass(frozen=True, kw_only=True)
class NeighbourhoodConfig:
    """One scale of a set abstraction: search radius, number of neighbours, and layers."""

    radius_m: float
    """Neighbours are the points nearer than this."""
    num_neighbours: int
    """Number of neighbours used."""
    widths: tuple[int, ...]
    """Output channels of the layers applied to each neighbour."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        if not 0 < self.radius_m <= _LARGEST_RADIUS_M:
            raise ValueError(
                f"radius_m must be positive and up to {_LARGEST_RADIUS_M:g}, got {self.radius_m}"
            )
        check_numbers(self, "at least 1", "num_neighbours")
        check_widths("widths", self.widths)


@dataclass(frozen=True, kw_only=True)
class AbstractionConfig:
    """One level of a point network: fewer points with more features."""

    num_centers: int
    """Number of centres of the level; fewer where the cloud has fewer points."""
    scales: tuple[NeighbourhoodConfig, ...]
    """Neighbourhoods in parallel; their channels are concatenated."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        check_range("num_centers", self.num_centers, 1, _MAX_CENTERS)
        if not self.scales:
            raise ValueError("scales must hold one neighbourhood or more, got none")
        if self.numbers > MAX_NUMBERS:
            raise ValueError(
                f"num_centers, num_neighbours and widths make a layer of {self.numbers} numbers, "
                f"expected up to {MAX_NUMBERS}"
            )

    @property
    def out_channels(self) -> int:
        """Number of features of each centre."""
        return sum(scale.widths[-1] for scale in self.scales)

    @property
    def numbers(self) -> int:
        """Number of values in its largest layer's output."""
        return self.num_centers * max(
            scale.num_neighbours * max(scale.widths) for scale in self.scales
        )


def _level(num_centers: int, *scales: tuple[float, int, tuple[int, ...]]) -> AbstractionConfig:
    return AbstractionConfig(
        num_centers=num_centers,
        scales=tuple(
            NeighbourhoodConfig(radius_m=radius_m, num_neighbours=number, widths=widths)
            for radius_m, number, widths in scales
        ),
    )


# Defaults in tuples have names so that a run's saved settings can refer to them.
LEVEL_1: Final = _level(4096, (0.1, 16, (16, 16, 32)), (0.5, 32, (32, 32, 64)))
LEVEL_2: Final = _level(1024, (0.5, 16, (64, 64, 128)), (1.0, 32, (64, 96, 128)))
LEVEL_3: Final = _level(256, (1.0, 16, (128, 196, 256)), (2.0, 32, (128, 196, 256)))
LEVEL_4: Final = _level(64, (2.0, 16, (256, 256, 512)), (4.0, 32, (256, 384, 512)))
REGION_LEVEL_1: Final = _level(128, (0.2, 64, (128, 128)))
REGION_LEVEL_2: Final = _level(32, (0.4, 64, (128, 256)))


@dataclass(frozen=True, kw_only=True)
class PointBackboneConfig:
    """Settings of PointNet++ (Qi et al. 2017)."""

    in_channels: int = 0
    """Number of features of each point besides x, y, z: 1 for the reflectance."""
    levels: tuple[AbstractionConfig, ...] = (LEVEL_1, LEVEL_2, LEVEL_3, LEVEL_4)
    """Set abstractions, the finest first."""
    propagation_widths: tuple[tuple[int, ...], ...] = (
        (128, 128),
        (256, 256),
        (512, 512),
        (512, 512),
    )
    """Layers of the feature propagations, the finest first: one entry for each level."""

    def __post_init__(self) -> None:
        """Check the numbers, and that each level has a propagation."""
        check_numbers(self, "at least 0", "in_channels")
        if not self.levels or len(self.levels) != len(self.propagation_widths):
            raise ValueError(
                "propagation_widths must hold one entry for each of one or more levels, got "
                f"{len(self.propagation_widths)} for {len(self.levels)}"
            )
        for widths in self.propagation_widths:
            check_widths("propagation_widths", widths)

    @property
    def out_channels(self) -> int:
        """Number of features of each point."""
        return self.propagation_widths[0][-1]


@dataclass(frozen=True, kw_only=True)
class BoxCodingConfig:
    """Bins of the box encoding."""

    scope_m: float = 3.0
    """Largest distance of a centre from its point, along x and along y."""
    bin_m: float = 0.5
    """Length of a bin of the centre."""
    heading_bins: int = 12
    """Number of bins over the full turn; the first is centred on yaw 0."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        bins = 2 * self.scope_m / self.bin_m if self.bin_m > 0 else 0.0
        if not (0 < self.scope_m < math.inf and 1 <= bins < math.inf and bins == round(bins)):
            raise ValueError(
                f"2 * scope_m must be a multiple of bin_m, both positive, got {self.scope_m} and "
                f"{self.bin_m}"
            )
        check_numbers(self, "at least 1", "heading_bins")

    @property
    def center_bins(self) -> int:
        """Number of bins along x, and also along y."""
        return round(2 * self.scope_m / self.bin_m)

    @property
    def heading_bin_rad(self) -> float:
        """Width of a bin of the heading."""
        return 2 * math.pi / self.heading_bins

    @property
    def widths(self) -> tuple[int, ...]:
        """Channels of a point's prediction: each part of `BoxPrediction` in order."""
        center, heading = self.center_bins, self.heading_bins
        return center, center, heading, center, center, heading, 1, 3

    @property
    def channels(self) -> int:
        """Number of channels of the prediction for one point."""
        return sum(self.widths)


@dataclass(frozen=True, kw_only=True)
class ProposalNetworkConfig:
    """Settings of the first stage's network."""

    classes: tuple[RoadUserClass, ...] = (CAR,)
    """Classes to propose."""
    backbone: PointBackboneConfig = field(default_factory=PointBackboneConfig)
    """Backbone for point features."""
    coding: BoxCodingConfig = field(default_factory=BoxCodingConfig)
    """Encoding of boxes relative to points."""
    head_width: int = 128
    """Channels of each head's hidden layer."""
    dropout: float = 0.5
    """Dropout rate in the heads."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        check_different("classes", self.classes, [entry.name for entry in self.classes])
        check_numbers(self, "at least 1", "head_width")
        if not 0 <= self.dropout < 1:
            raise ValueError(f"dropout must be from 0 to below 1, got {self.dropout}")


@dataclass(frozen=True, kw_only=True)
class ProposalConfig:
    """Selection of proposals: Shi et al. 2019 (PointRCNN), section 3.1, at test time."""

    num_proposals: int = 100
    """Largest number of proposals for a sweep."""
    num_candidates: int = 9000
    """Number of boxes with the highest scores that are considered."""
    iou: float = 0.8
    """IoU from above beyond which a box with a lower score is removed."""
    near_m: float = 40.0
    """Largest distance from the sensor of a near box."""
    near_share: float = 0.7
    """Share of near boxes among candidates and proposals: far cars have few points, and near ones
    would otherwise crowd them out."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        if not 1 <= self.num_proposals <= self.num_candidates:
            raise ValueError(
                f"num_proposals must be from 1 to num_candidates {self.num_candidates}, got "
                f"{self.num_proposals}"
            )
        if self.num_proposals * self.num_candidates > _MAX_PAIRS:
            raise ValueError(
                f"num_proposals times num_candidates must be up to {_MAX_PAIRS}, got "
                f"{self.num_proposals} times {self.num_candidates}"
            )
        check_numbers(self, "from 0 to 1", "iou", "near_share")
        check_numbers(self, "positive and finite", "near_m")


@dataclass(frozen=True, kw_only=True)
class RoiPoolingConfig:
    """Pooling of points around proposals: Shi et al. 2019 (PointRCNN), section 3.2."""

    margin_m: float = 1.0
    """Margin around a proposal, to include its surroundings."""
    num_points: int = 512
    """Number of points for each proposal."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        check_range("margin_m", self.margin_m, 0, _LARGEST_MARGIN_M)
        check_range("num_points", self.num_points, 1, _MAX_ROI_POINTS)


@dataclass(frozen=True, kw_only=True)
class RefinementConfig:
    """The second stage: three set abstractions of each region of interest, and two heads."""

    in_channels: int = 128
    """Number of features of each point besides x, y, z."""
    levels: tuple[AbstractionConfig, ...] = (REGION_LEVEL_1, REGION_LEVEL_2)
    """Set abstractions, the finest first."""
    global_widths: tuple[int, ...] = (256, 512)
    """Layers of the last set abstraction, which pools all remaining points."""
    head_widths: tuple[int, ...] = (256, 256)
    """Hidden layers of each head."""
    batch_norm: bool = False
    """Whether layers have batch normalisation."""
    first_box: tuple[float, ...] = (25.0, 0.0, -1.0, *CAR.mean_size_m, -math.pi / 2)
    """Output of an untrained network, about the mean of the boxes to learn: x, y, z, length, width,
    height, yaw in the frame of the points [m, rad]. The yaw is between those of cars that drive
    away (0) and of oncoming ones (-pi)."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        check_numbers(self, "at least 0", "in_channels")
        if len(self.first_box) != 7 or not all(map(math.isfinite, self.first_box)):
            raise ValueError(f"first_box must be 7 finite numbers, got {self.first_box}")
        check_widths("global_widths", self.global_widths)
        if self.head_widths:
            check_widths("head_widths", self.head_widths)

    def numbers(self, num_points: int) -> int:
        """Compute the size of the largest layer's output for a region of `num_points` points."""
        last = self.levels[-1].num_centers if self.levels else num_points
        levels = (level.numbers for level in self.levels)
        return max(num_points * (3 + self.in_channels), *levels, last * max(self.global_widths))


@dataclass(frozen=True, kw_only=True)
class FocalLossConfig:
    """Focal loss settings, which balance few foreground points against many easy ones."""

    alpha: float = 0.25
    """Weight of foreground points; background points have 1 - alpha."""
    gamma: float = 2.0
    """Focusing exponent: how fast the weight of correct predictions falls."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        check_numbers(self, "from 0 to 1", "alpha")
        check_numbers(self, "finite and not negative", "gamma")


@dataclass(frozen=True, kw_only=True)
class ProposalLossConfig:
    """Weights of the first stage's losses."""

    focal: FocalLossConfig = field(default_factory=FocalLossConfig)
    """Focal loss of the segmentation."""
    size_weight: float = 3.0
    """Weight of the size loss relative to centre and heading."""
    ignored_margin_m: float = 0.2
    """Margin around boxes in which points are ignored."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        check_numbers(self, "finite and not negative", "ignored_margin_m", "size_weight")


@dataclass(frozen=True, kw_only=True)
class ProposalSamplingConfig:
    """Settings for sampling a frame's proposals to train the second stage."""

    num_samples: int = 64
    """Number of samples for each frame."""
    max_foreground: int = 32
    """Largest number of foreground samples, if the frame also has background."""
    foreground_iou: float = 0.55
    """3D IoU from which a proposal is foreground."""
    background_iou: float = 0.45
    """3D IoU below which a proposal is background; from here to `foreground_iou` it is unused."""
    easy_iou: float = 0.05
    """3D IoU below which background is easy."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        if not 1 <= self.max_foreground <= self.num_samples:
            raise ValueError(
                f"max_foreground must be from 1 to num_samples {self.num_samples}, got "
                f"{self.max_foreground}"
            )
        if not 0 <= self.easy_iou <= self.background_iou <= self.foreground_iou <= 1:
            raise ValueError(
                "easy_iou, background_iou and foreground_iou must rise from 0 to 1, got "
                f"{self.easy_iou}, {self.background_iou}, {self.foreground_iou}"
            )


@dataclass(frozen=True, kw_only=True)
class RefinementLossConfig:
    """IoU thresholds and the weight of the size."""

    foreground_iou: float = 0.55
    """3D IoU from which a proposal's box is trained."""
    size_weight: float = 3.0
    """Weight of the size in the sum of the box's parts."""
    positive_iou: float = 0.6
    """3D IoU from which a proposal is positive for the confidence."""
    negative_iou: float = 0.45
    """3D IoU up to which a proposal is negative; from here to `positive_iou` it is unused."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        if not 0 <= self.negative_iou < self.positive_iou <= 1:
            raise ValueError(
                "negative_iou must be below positive_iou and both from 0 to 1, got "
                f"{self.negative_iou} and {self.positive_iou}"
            )
        check_numbers(self, "from 0 to 1", "foreground_iou")
        check_numbers(self, "finite and not negative", "size_weight")

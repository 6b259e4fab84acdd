"""Settings of a 3D detector: its input, its two stages, and suppression.

The defaults are those of the published two-stage detector (Shi et al. 2019, PointRCNN), with the
plain second stage.
"""

import math
from dataclasses import dataclass, field

from sightline.detection3d.alignment import ClassAlignment
from sightline.detection3d.axes_config import HeadingHypothesesConfig
from sightline.detection3d.classes import RoadUserClass
from sightline.detection3d.config import MOST_NUMBERS, RefinementConfig
from sightline.detection3d.pillar_config import PillarNetworkConfig
from sightline.detection3d.pillar_detections import PillarDetectionConfig
from sightline.detection3d.proposal_network import ProposalNetworkConfig
from sightline.detection3d.proposals import ProposalConfig
from sightline.detection3d.region_config import RegionConfig
from sightline.detection3d.roi_pooling import RoiPoolingConfig
from sightline.detection3d.suppression import SuppressionConfig
from sightline.files.settings import IN_USE_ALONE

# Bounds on settings that cost time or memory but add no weights: weights files may come from
# anywhere.
_MOST_POINTS = 2**22
_MOST_PROPOSALS = 10_000
_MOST_DISTANCES = 2**32  # between points and centres: some seconds
_FARTHEST_M = 1e5


@dataclass(frozen=True, kw_only=True)
class SweepConfig:
    """Part of a sweep that the network gets: the same for training, scoring and use."""

    num_points: int | None = 16_384
    """Number of points drawn; a smaller sweep repeats some. None: all points, in their order."""
    lowest_m: tuple[float, float, float] = (0.0, -40.0, -3.0)
    """Smallest x, y, z of points (LiDAR frame)."""
    highest_m: tuple[float, float, float] = (70.4, 40.0, 1.0)
    """Largest x, y, z of points."""
    far_m: float = 40.0
    """All points from this x on are kept, if there is room: far objects have few points."""
    in_view: bool = True
    """Whether to keep only points inside the camera image: elsewhere KITTI has no labels."""
    reflectance: bool = False
    """Whether points have their reflectance."""
    height_offset_m: float = 0.0
    """Height added to points, for a LiDAR that is mounted higher than KITTI's (1.73 m)."""

    def __post_init__(self) -> None:
        """Checks the numbers."""
        if self.num_points is not None and not 1 <= self.num_points <= _MOST_POINTS:
            raise ValueError(
                f"input.num_points must be from 1 to {_MOST_POINTS}, got {self.num_points}"
            )
        numbers = (*self.lowest_m, *self.highest_m, self.far_m, self.height_offset_m)
        if not all(abs(number) <= _FARTHEST_M for number in numbers):
            raise ValueError(f"lengths of the input must be within {_FARTHEST_M:g}, got {numbers}")
        if any(low >= high for low, high in zip(self.lowest_m, self.highest_m, strict=True)):
            raise ValueError(
                f"input.lowest_m must be below highest_m in x, y and z, got {self.lowest_m} and "
                f"{self.highest_m}"
            )


@dataclass(frozen=True, kw_only=True)
class Detection3DConfig:
    """Settings of a 3D detector."""

    input: SweepConfig = field(default_factory=SweepConfig)
    """Part of a sweep that the network gets."""
    points: ProposalNetworkConfig | None = field(default_factory=ProposalNetworkConfig)
    """First stage on points: for each point a foreground score and a box."""
    pillars: PillarNetworkConfig | None = None
    """Compact first stage instead: centres and boxes in a map of pillars."""
    proposals: ProposalConfig = field(default_factory=ProposalConfig)
    """Selection of the point stage's boxes for the second stage."""
    training_proposals: ProposalConfig = field(
        default_factory=lambda: ProposalConfig(num_proposals=300)
    )
    """The same selection while the second stage is trained."""
    centers: PillarDetectionConfig = field(default_factory=PillarDetectionConfig)
    """Selection of the pillar stage's boxes for the second stage."""
    refinement: RefinementConfig | None = field(default_factory=RefinementConfig)
    """Second stage: a box and its confidence from the points around each proposal."""
    regions: RegionConfig | None = None
    """Compact second stage instead. With neither, the proposals are the detections."""
    pooling: RoiPoolingConfig = field(default_factory=RoiPoolingConfig)
    """Pooling of the sweep's points around a proposal, for the plain second stage."""
    suppression: SuppressionConfig = field(default_factory=SuppressionConfig)
    """Suppression of overlapping boxes before the output."""
    flip_test: bool = field(default=False, metadata=IN_USE_ALONE)
    """Whether predictors also run the compact first stage on the mirrored sweep, and the second
    stage on regions turned round; see `answer_of_views`."""
    axes: HeadingHypothesesConfig | None = field(default=None, metadata=IN_USE_ALONE)
    """Proposals that predictors refine from several axes with the compact stage. None: none."""
    alignment: tuple[ClassAlignment, ...] = field(default=(), metadata=IN_USE_ALONE)
    """Adaptation of detections to the labels of other sensors, at inference only: training scores
    boxes without it, and the weights that it writes have none."""

    def __post_init__(self) -> None:
        """Checks that there is a first stage, and that the stages fit together."""
        if (self.points is None) == (self.pillars is None):
            raise ValueError("a detector needs one first stage: set points or pillars, not both")
        if self.refinement is not None and self.regions is not None:
            raise ValueError(
                "a detector has one second stage at most: set refinement or regions to null"
            )
        most = max(
            self.proposals.num_proposals,
            self.training_proposals.num_proposals,
            self.centers.max_boxes,
        )
        if most > _MOST_PROPOSALS:
            raise ValueError(
                f"proposals.num_proposals and centers.max_boxes must be up to {_MOST_PROPOSALS}"
            )
        if self.points is not None:
            self._check_points(self.points)
        if self.pillars is not None and self.pillars.grid.reflectance != self.input.reflectance:
            raise ValueError(
                f"pillars.grid.reflectance is {self.pillars.grid.reflectance}, but "
                f"input.reflectance {self.input.reflectance}: set both alike"
            )
        self._check_second()
        self._check_work()
        self._check_alignment()
        self._check_flip_test()
        self._check_axes()

    @property
    def classes(self) -> tuple[RoadUserClass, ...]:
        """Classes that the first stage proposes, in the order of its outputs."""
        first = self.points or self.pillars
        assert first is not None, "checked when built"
        return first.classes

    def _check_work(self) -> None:
        """Check the work for the proposals and the points around them together."""
        name, most = "centers.max_boxes", self.centers.max_boxes
        if self.points is not None:
            name, most = "proposals.num_proposals", self.proposals.num_proposals
        if self.regions is not None:
            stage, numbers = "regions", self.regions.numbers
            numbers *= 1 if self.axes is None else self.axes.number
        elif self.refinement is not None:
            stage, numbers = "refinement", self.refinement.numbers(self.pooling.num_points)
        else:
            return
        if most * numbers > MOST_NUMBERS:
            raise ValueError(
                f"{stage} makes layers of {numbers} numbers of a proposal, of which {name} allows "
                f"{most}, expected up to {MOST_NUMBERS} numbers together: lower {name}, or the "
                "points of a proposal"
            )

    def _check_alignment(self) -> None:
        known = [each.name for each in self.classes]
        names = [each.name for each in self.alignment]
        if len(set(names)) < len(names):
            raise ValueError("alignment names a class more than once; keep one entry of each")
        for each in self.alignment:
            if each.name not in known:
                raise ValueError(
                    f"alignment names {each.name}, but the classes are {', '.join(known)}"
                )

    def _check_flip_test(self) -> None:
        if not self.flip_test:
            return
        if self.pillars is None or self.refinement is not None:
            raise ValueError(
                "flip_test is of the compact stages: set it to false, or pillars and no refinement"
            )
        if self.regions is not None and not self.regions.canonical:
            raise ValueError(
                "flip_test needs regions in their own frames: set it to false, or regions.canonical"
            )
        right, left = self.pillars.grid.y_m
        if not math.isclose(-right, left, abs_tol=1e-6):
            raise ValueError(
                "flip_test needs a grid as far to the left as to the right, got pillars.grid.y_m "
                f"{right} to {left}: change it, or set flip_test to false"
            )

    def _check_axes(self) -> None:
        if self.axes is None:
            return
        known = [each.name for each in self.classes]
        unknown = sorted(set(self.axes.class_names) - set(known))
        if unknown:
            raise ValueError(
                f"axes names {', '.join(unknown)}, but the classes are {', '.join(known)}"
            )
        if self.regions is None or not self.regions.canonical:
            raise ValueError(
                "axes needs regions in their own frames: set it to null, or regions.canonical"
            )
        if self.axes.passes > self.regions.passes:
            raise ValueError(
                f"axes.passes is {self.axes.passes}, expected up to regions.passes "
                f"({self.regions.passes})"
            )

    def _check_points(self, points: ProposalNetworkConfig) -> None:
        if self.input.num_points is None:
            raise ValueError("input.num_points must be a number where points are the first stage")
        centers = points.backbone.levels[0].num_centers
        if self.input.num_points * centers > _MOST_DISTANCES:
            raise ValueError(
                "input.num_points times num_centers of the first of points.backbone.levels must "
                f"be up to {_MOST_DISTANCES}, got {self.input.num_points} times {centers}"
            )
        extra = points.backbone.in_channels
        if extra != self.input.reflectance:
            raise ValueError(
                f"points.backbone.in_channels is {extra}, expected {int(self.input.reflectance)}: "
                "1 with input.reflectance, else 0"
            )

    def _check_second(self) -> None:
        given = 0 if self.points is None else self.points.backbone.out_channels
        if self.refinement is not None and self.refinement.in_channels != given:
            raise ValueError(
                f"refinement.in_channels is {self.refinement.in_channels}, expected {given}, the "
                "features that the first stage gives each point"
            )
        if self.regions is None:
            return
        told = given if self.points is not None else int(self.input.reflectance)
        if self.regions.in_channels != told:
            raise ValueError(
                f"regions.in_channels is {self.regions.in_channels}, expected {told}: the features "
                "that the first stage gives each point, else 1 with input.reflectance and 0 without"
            )
        if self.regions.classes != self.classes:
            raise ValueError(
                f"regions.classes are {', '.join(each.name for each in self.regions.classes)}, "
                f"expected the first stage's with its sizes: "
                f"{', '.join(each.name for each in self.classes)}"
            )

"""Settings of a 3D detector and of its training losses."""

import math
from dataclasses import dataclass, field

from sightline.detection3d.checks import MAX_NUMBERS, check_different, check_numbers
from sightline.detection3d.classes import RoadUserClass
from sightline.detection3d.pillars.config import (
    PillarDetectionConfig,
    PillarLossConfig,
    PillarNetworkConfig,
    PillarTargetsConfig,
)
from sightline.detection3d.pillars.region_config import (
    RegionConfig,
    RegionExamplesConfig,
    RegionLossConfig,
)
from sightline.detection3d.points.config import (
    LEVEL_1,
    LEVEL_2,
    LEVEL_3,
    LEVEL_4,
    REGION_LEVEL_1,
    REGION_LEVEL_2,
    ProposalConfig,
    ProposalLossConfig,
    ProposalNetworkConfig,
    ProposalSamplingConfig,
    RefinementConfig,
    RefinementLossConfig,
    RoiPoolingConfig,
)
from sightline.detection3d.suppression import ClassAlignment, SuppressionConfig
from sightline.detection3d.sweeps import SweepConfig
from sightline.files.settings import INFERENCE_ONLY
from sightline.geometry.ranges import check_range

# Settings that earlier versions saved name the levels here.
__all__ = [
    "LEVEL_1",
    "LEVEL_2",
    "LEVEL_3",
    "LEVEL_4",
    "REGION_LEVEL_1",
    "REGION_LEVEL_2",
    "Detection3DConfig",
    "Detection3DLossConfig",
    "HeadingHypothesesConfig",
]

_MAX_AXES = 16


@dataclass(frozen=True, kw_only=True)
class HeadingHypothesesConfig:
    """Classes, axes and passes for refinement from several axes by the compact second stage."""

    class_names: tuple[str, ...] = ("Pedestrian",)
    """Names among the detector's classes."""
    number: int = 2
    """Number of axes of each proposal, evenly spread over half a turn, its own axis first."""
    passes: int = 1
    """Number of second-stage passes after which only each proposal's best-scored box goes on."""
    least_gain: float = 0.015
    """Share by which the score from another axis must exceed that from the proposal's own axis."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        check_different("axes.class_names", self.class_names, self.class_names)
        check_range("axes.number", self.number, 2, _MAX_AXES)
        check_numbers(self, "at least 1", "passes", within="axes.")
        check_numbers(self, "finite and not negative", "least_gain", within="axes.")


_MAX_PROPOSALS = 10_000
_MAX_DISTANCES = 2**32  # between points and centres: some seconds


@dataclass(frozen=True, kw_only=True)
class Detection3DConfig:
    """Settings of a 3D detector; by default of the design that ships: pillars, then regions.

    The published settings (Shi et al. 2019, PointRCNN, with the plain second stage) are those of
    the recipe `detection3d-baseline-kitti`. Settings for use alone are off by default.
    """

    input: SweepConfig = field(default_factory=SweepConfig)
    """Part of a sweep that the network gets."""
    pillars: PillarNetworkConfig | None = field(default_factory=PillarNetworkConfig)
    """First stage on pillars: centres and boxes in a map."""
    points: ProposalNetworkConfig | None = None
    """First stage on points instead: for each point a foreground score and a box."""
    proposals: ProposalConfig = field(default_factory=ProposalConfig)
    """Selection of the point stage's boxes for the second stage."""
    training_proposals: ProposalConfig = field(
        default_factory=lambda: ProposalConfig(num_proposals=300)
    )
    """Selection of the point stage's boxes while the second stage is trained."""
    centers: PillarDetectionConfig = field(default_factory=PillarDetectionConfig)
    """Selection of the pillar stage's boxes for the second stage."""
    regions: RegionConfig | None = field(default_factory=RegionConfig)
    """Second stage on regions: changes of a proposal's box from the points around it."""
    refinement: RefinementConfig | None = None
    """Plain second stage instead: a box and its confidence. With neither, the proposals are the
    detections."""
    pooling: RoiPoolingConfig = field(default_factory=RoiPoolingConfig)
    """Pooling of the sweep's points around a proposal, for the plain second stage."""
    suppression: SuppressionConfig = field(default_factory=SuppressionConfig)
    """Suppression of overlapping boxes before the output."""
    flip_test: bool = field(default=False, metadata=INFERENCE_ONLY)
    """Whether predictors also run the compact first stage on the mirrored sweep, and the second
    stage on regions turned round; see `mean_over_views`."""
    axes: HeadingHypothesesConfig | None = field(default=None, metadata=INFERENCE_ONLY)
    """Proposals that predictors refine from several axes with the compact stage. None: none."""
    alignment: tuple[ClassAlignment, ...] = field(default=(), metadata=INFERENCE_ONLY)
    """Adaptation of detections to the labels of other sensors, at inference only: training scores
    boxes without it, and the weights that it writes have none."""

    def __post_init__(self) -> None:
        """Check that there is a first stage, and that the stages fit together."""
        if (self.points is None) == (self.pillars is None):
            raise ValueError(
                "a detector needs one first stage: set pillars or points, and the other to null"
            )
        if self.refinement is not None and self.regions is not None:
            raise ValueError(
                "a detector has at most one second stage: set refinement or regions to null"
            )
        proposals = max(self.proposals.num_proposals, self.training_proposals.num_proposals)
        if max(proposals, self.centers.max_boxes) > _MAX_PROPOSALS:
            raise ValueError(
                f"proposals.num_proposals and centers.max_boxes must be up to {_MAX_PROPOSALS}"
            )
        if self.points is not None:
            self._check_points(self.points)
        elif self.pillars is not None and self.pillars.grid.reflectance != self.input.reflectance:
            raise ValueError(
                f"pillars.grid.reflectance is {self.pillars.grid.reflectance}, but "
                f"input.reflectance {self.input.reflectance}: set both alike"
            )
        self._check_second()
        self._check_in_use()
        self._check_flip_test()

    @property
    def classes(self) -> tuple[RoadUserClass, ...]:
        """Classes that the first stage proposes, in the order of its outputs."""
        first = self.points or self.pillars
        assert first is not None, "checked when built"
        return first.classes

    def _check_points(self, points: ProposalNetworkConfig) -> None:
        if self.input.num_points is None:
            raise ValueError("input.num_points must be a number where points are the first stage")
        centers = points.backbone.levels[0].num_centers
        if self.input.num_points * centers > _MAX_DISTANCES:
            raise ValueError(
                "input.num_points times num_centers of the first of points.backbone.levels must "
                f"be up to {_MAX_DISTANCES}, got {self.input.num_points} times {centers}"
            )
        extra = points.backbone.in_channels
        if extra != self.input.reflectance:
            raise ValueError(
                f"points.backbone.in_channels is {extra}, expected {int(self.input.reflectance)}: "
                "1 with input.reflectance, else 0"
            )

    def _check_second(self) -> None:
        """Check the second stage's inputs and its work for all proposals together."""
        name, max_boxes = "centers.max_boxes", self.centers.max_boxes
        given = 0
        if self.points is not None:
            name, max_boxes = "proposals.num_proposals", self.proposals.num_proposals
            given = self.points.backbone.out_channels
        if self.refinement is not None:
            stage, numbers = "refinement", self.refinement.numbers(self.pooling.num_points)
            if self.refinement.in_channels != given:
                raise ValueError(
                    f"refinement.in_channels is {self.refinement.in_channels}, expected {given}, "
                    "the features that the first stage gives each point"
                )
        elif self.regions is not None:
            stage, numbers = (
                "regions",
                self.regions.numbers * (self.axes.number if self.axes else 1),
            )
            expected = given if self.points is not None else int(self.input.reflectance)
            if self.regions.in_channels != expected:
                raise ValueError(
                    f"regions.in_channels is {self.regions.in_channels}, expected {expected}: the "
                    "features that the first stage gives each point, else 1 with "
                    "input.reflectance and 0 without"
                )
            if self.regions.classes != self.classes:
                raise ValueError(
                    f"regions.classes are {', '.join(each.name for each in self.regions.classes)}, "
                    f"expected the first stage's with its sizes: {self._named_classes}"
                )
        else:
            return
        if max_boxes * numbers > MAX_NUMBERS:
            raise ValueError(
                f"{stage} makes layers of {numbers} numbers of a proposal, of which {name} allows "
                f"{max_boxes}, expected up to {MAX_NUMBERS} numbers together: lower {name}, or the "
                "points of a proposal"
            )

    def _check_in_use(self) -> None:
        """Check the settings of alignment and axes."""
        known = [each.name for each in self.classes]
        aligned = [each.name for each in self.alignment]
        if len(set(aligned)) < len(aligned):
            raise ValueError("alignment names a class more than once; keep one entry of each")
        chosen = () if self.axes is None else self.axes.class_names
        for part, names in (("alignment", aligned), ("axes", chosen)):
            unknown = sorted(set(names) - set(known))
            if unknown:
                raise ValueError(
                    f"{part} names {', '.join(unknown)}, but the classes are {self._named_classes}"
                )
        if self.axes is not None:
            if self.regions is None or not self.regions.canonical:
                raise ValueError(
                    "axes needs regions in their own frames: set it to null, or regions.canonical"
                )
            if self.axes.passes > self.regions.passes:
                raise ValueError(
                    f"axes.passes is {self.axes.passes}, expected up to regions.passes "
                    f"({self.regions.passes})"
                )

    def _check_flip_test(self) -> None:
        if self.flip_test:
            if self.pillars is None or self.refinement is not None:
                raise ValueError(
                    "flip_test is of the compact stages: set it to false, or pillars and no "
                    "refinement"
                )
            if self.regions is not None and not self.regions.canonical:
                raise ValueError(
                    "flip_test needs regions in their own frames: set it to false, or "
                    "regions.canonical"
                )
            right, left = self.pillars.grid.y_m
            if not math.isclose(-right, left, abs_tol=1e-6):
                raise ValueError(
                    "flip_test needs a grid as far to the left as to the right, got "
                    f"pillars.grid.y_m {right} to {left}: change it, or set flip_test to false"
                )

    @property
    def _named_classes(self) -> str:
        return ", ".join(each.name for each in self.classes)


@dataclass(frozen=True, kw_only=True)
class Detection3DLossConfig:
    """Settings of both stages' losses."""

    points: ProposalLossConfig = field(default_factory=ProposalLossConfig)
    """Losses of the point first stage."""
    pillars: PillarLossConfig = field(default_factory=PillarLossConfig)
    """Losses of the pillar first stage."""
    cells: PillarTargetsConfig = field(default_factory=PillarTargetsConfig)
    """Targets of the pillar first stage's cells."""
    first_weight: float = 1.0
    """Weight of the first stage's loss, where both are trained."""
    sampling: ProposalSamplingConfig = field(default_factory=ProposalSamplingConfig)
    """Sampling of proposals to train the plain second stage."""
    refinement: RefinementLossConfig = field(default_factory=RefinementLossConfig)
    """Losses of the plain second stage."""
    region_examples: RegionExamplesConfig = field(default_factory=RegionExamplesConfig)
    """Training examples of the compact second stage."""
    regions: RegionLossConfig = field(default_factory=RegionLossConfig)
    """Losses of the compact second stage."""

    def __post_init__(self) -> None:
        """Check the weight."""
        check_numbers(self, "finite and not negative", "first_weight", within="loss.")

"""Settings of the second stage on regions: network, examples and losses."""

from dataclasses import dataclass

from sightline.detection3d.checks import check_different, check_numbers, check_widths
from sightline.detection3d.classes import CAR, CYCLIST, PEDESTRIAN, RoadUserClass
from sightline.geometry.ranges import check_range

# Bounds on settings that cost time or memory but add no weights: weights files may come from
# anywhere.
_MAX_PASSES = 10
_MAX_POINTS = 2**14
_LARGEST_MARGIN_M = 100.0


@dataclass(frozen=True, kw_only=True)
class RegionConfig:
    """The compact second stage: one small point network for the regions of all classes."""

    classes: tuple[RoadUserClass, ...] = (CAR, PEDESTRIAN, CYCLIST)
    """Classes of the first stage, in its order."""
    margin_m: tuple[float, float, float] = (0.8, 0.6, 0.4)
    """Margin of a region beyond its box in length, width and height, at either end."""
    num_points: int = 192
    """Number of points drawn for each region."""
    in_channels: int = 0
    """Features of each point besides its coordinates: reflectance, mask, or another network's."""
    point_widths: tuple[int, ...] = (64, 96)
    """Layers applied to each point separately."""
    region_width: int = 192
    """Width of the layer applied to each point together with the region's pooled features."""
    head_widths: tuple[int, ...] = (192, 128)
    """Hidden layers of the head."""
    canonical: bool = True
    """Whether points are in the proposal's frame, with the distances to its faces; else they are in
    the sweep's frame."""
    passes: int = 2
    """Number of passes; each pass uses the points around the boxes of the one before."""
    mean_with_first: tuple[str, ...] = ()
    """Classes for which the result is the mean of the first and last pass (`mean_refined`), because
    the first is closer to the first stage's boxes. Other classes use the last pass."""
    quality_share: float = 0.5
    """Exponent of the last quality in the score; the exponent of the proposal's score is 1 less
    this."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        check_different("classes", self.classes, [entry.name for entry in self.classes])
        for margin in self.margin_m:
            check_range("margin_m", margin, 0, _LARGEST_MARGIN_M)
        check_range("num_points", self.num_points, 1, _MAX_POINTS)
        check_numbers(self, "at least 0", "in_channels")
        check_widths("point_widths", self.point_widths)
        check_widths("head_widths", self.head_widths)
        check_numbers(self, "at least 1", "region_width")
        check_range("passes", self.passes, 1, _MAX_PASSES)
        unknown = set(self.mean_with_first) - {entry.name for entry in self.classes}
        if unknown:
            raise ValueError(
                f"mean_with_first names {', '.join(sorted(unknown))}, but the classes are "
                f"{', '.join(entry.name for entry in self.classes)}"
            )
        check_numbers(self, "from 0 to 1", "quality_share")

    @property
    def point_channels(self) -> int:
        """Number of channels of a region's point."""
        return (9 if self.canonical else 3) + self.in_channels

    @property
    def numbers(self) -> int:
        """Number of values in the largest layer's output for a region."""
        return self.num_points * max(self.point_channels, *self.point_widths, self.region_width)

    @property
    def context_channels(self) -> int:
        """Number of channels of a region's context."""
        return 7 + len(self.classes)


@dataclass(frozen=True, kw_only=True)
class RegionExamplesConfig:
    """Number of examples for each sweep, and their errors (standard deviations)."""

    num_objects: int = 24
    """Number of moved ground truths."""
    num_background: int = 8
    """Number of boxes without an object."""
    num_proposals: int = 8
    """Number of first-stage proposals, if there are any, on objects or background alike."""
    center_share: float = 0.07
    """Shift along x and along y, as a share of sqrt(length x width)."""
    least_center_m: float = 0.08
    """Smallest standard deviation of the shift along x and along y."""
    height_share: float = 0.065
    """Shift along z, as a share of the height."""
    log_sizes: tuple[float, float, float] = (0.06, 0.04, 0.05)
    """Changes of the logarithms of length, width and height."""
    yaw_rad: float = 0.06
    """Rotation."""
    doubled_share: float = 0.3
    """Share of boxes with doubled shift, size change and rotation."""
    reversed_share: float = 0.15
    """Share of boxes that are turned to face backwards."""
    proposal_factor: float = 0.5
    """Factor on these errors for first-stage proposals."""
    min_iou: float = 0.2
    """IoU from above with an object from which a first-stage proposal is matched to it."""
    max_background_iou: float = 0.02
    """Largest IoU from above of a background proposal with objects of its class and with those
    ignored for it."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        check_numbers(self, "at least 0", "num_objects", "num_background", "num_proposals")
        errors = ("center_share", "least_center_m", "height_share", "yaw_rad", "log_sizes")
        check_numbers(self, "finite and not negative", *errors)
        check_numbers(self, "from 0 to 1", "doubled_share", "reversed_share", "proposal_factor")
        if not 0 <= self.max_background_iou <= self.min_iou <= 1:
            raise ValueError(
                "max_background_iou and min_iou must rise from 0 to 1, got "
                f"{self.max_background_iou} and {self.min_iou}"
            )


@dataclass(frozen=True, kw_only=True)
class RegionLossConfig:
    """Weights of the second stage's losses."""

    value_weight: float = 1.0
    """Weight of the loss on the box code."""
    corner_weight: float = 4.0
    """Weight of the corner loss; 0: no corner loss."""
    front_weight: float = 1.0
    """Weight of the loss on the front."""
    quality_weight: float = 0.5
    """Weight of the loss on the predicted IoU."""
    knee: float = 0.25
    """Error of the code where the loss changes from quadratic to linear."""
    corner_knee_m: float = 0.05
    """Error of a corner where the corner loss changes from quadratic to linear."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        weights = (f"{name}_weight" for name in ("value", "corner", "front", "quality"))
        check_numbers(self, "finite and not negative", *weights)
        check_numbers(self, "positive and finite", "knee", "corner_knee_m")

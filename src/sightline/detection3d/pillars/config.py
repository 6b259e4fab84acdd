"""Settings of the first stage on pillars: grid, network, decoding and training."""

from dataclasses import dataclass, field
from typing import Final

from sightline.detection3d.checks import check_different, check_numbers
from sightline.detection3d.classes import CAR, CYCLIST, PEDESTRIAN, RoadUserClass
from sightline.geometry.ranges import check_range

HEAD_STRIDE: Final = 2
"""Length and width of a head cell, in cells of the features."""

LOCAL_CHANNELS: Final = 9
"""Number of local statistics: three means and six covariances."""

_COARSEST_STRIDE: Final = 8  # stride of the backbone's last stage
_MAX_NUMBERS: Final = 2**26  # values in the map: a network then takes 3 GB
_FARTHEST_M: Final = 1e5
_MAX_PAIRS: Final = 2**25  # pairs of boxes for the IoU: 256 MB for each value per pair
_MAX_WINDOW: Final = 15  # pillars; it is summed anew for each
_SLACK: Final = 1e-6  # rounding tolerance, in blocks of cells


@dataclass(frozen=True, kw_only=True)
class PillarGridConfig:
    """Grid of pillars on the ground: rows along x, columns along y, LiDAR frame."""

    x_m: tuple[float, float] = (0.0, 70.4)
    """Smallest and largest x."""
    y_m: tuple[float, float] = (-40.0, 40.0)
    """Smallest and largest y."""
    z_m: tuple[float, float] = (-4.0, 3.0)
    """Smallest and largest z of points."""
    cell_m: float = 0.2
    """Edge of a pillar."""
    slices: int = 10
    """Number of heights at which a pillar encodes occupancy."""
    lowest_slice_m: float = -2.8
    """Height of the lowest slice's middle."""
    slice_m: float = 0.4
    """Distance from one slice to the next."""
    reflectance: bool = False
    """Whether a pillar has its mean reflectance as a feature. It differs between sensors."""
    local_window: int = 0
    """Edge, in pillars, of the square whose points' mean and covariance are features of the pillar
    in its middle; odd. 0: none."""

    def __post_init__(self) -> None:
        """Check the numbers, and that the backbone can halve the grid in all its stages."""
        check_numbers(self, "positive and finite", "cell_m", "slice_m")
        check_numbers(self, "at least 1", "slices")
        if self.local_window and not (
            self.local_window % 2 and 0 < self.local_window <= _MAX_WINDOW
        ):
            raise ValueError(
                f"local_window must be 0 or odd and at most {_MAX_WINDOW}, got {self.local_window}"
            )
        check_range("lowest_slice_m", self.lowest_slice_m, -_FARTHEST_M, _FARTHEST_M)
        for name in ("x_m", "y_m", "z_m"):
            low, high = getattr(self, name)
            if not -_FARTHEST_M <= low < high <= _FARTHEST_M:
                raise ValueError(
                    f"{name} must rise and lie within {_FARTHEST_M:g}, got {low} to {high}"
                )
        x, y = ((high - low) / self.cell_m for low, high in (self.x_m, self.y_m))
        if not x * y * self.channels <= _MAX_NUMBERS:
            raise ValueError(
                f"the grid has {x:.0f} x {y:.0f} cells of {self.channels} numbers, expected up to "
                f"{_MAX_NUMBERS} numbers together; set a larger cell_m, or less ground"
            )
        for name in ("x_m", "y_m"):
            low, high = getattr(self, name)
            blocks = (high - low) / (_COARSEST_STRIDE * self.cell_m)
            if round(blocks) < 1 or abs(blocks - round(blocks)) > _SLACK:
                raise ValueError(
                    f"{name} must span a multiple of {_COARSEST_STRIDE} cells of {self.cell_m} m, "
                    f"got {low} to {high}"
                )

    @property
    def rows(self) -> int:
        """Pillars along x."""
        return round((self.x_m[1] - self.x_m[0]) / self.cell_m)

    @property
    def columns(self) -> int:
        """Pillars along y."""
        return round((self.y_m[1] - self.y_m[0]) / self.cell_m)

    @property
    def channels(self) -> int:
        """Features of each pillar."""
        local = LOCAL_CHANNELS if self.local_window else 0
        return self.slices + 6 + self.reflectance + local

    @property
    def head_cell_m(self) -> float:
        """Edge of a cell of the heads."""
        return HEAD_STRIDE * self.cell_m

    @property
    def head_size(self) -> tuple[int, int]:
        """Rows and columns of the heads."""
        return self.rows // HEAD_STRIDE, self.columns // HEAD_STRIDE


@dataclass(frozen=True, kw_only=True)
class PillarNetworkConfig:
    """The compact first stage: residual stages of strides 2, 4 and 8, heads at stride 2."""

    classes: tuple[RoadUserClass, ...] = (CAR, PEDESTRIAN, CYCLIST)
    """Classes to detect."""
    grid: PillarGridConfig = field(default_factory=PillarGridConfig)
    """Grid of pillars."""
    channels: tuple[int, int, int] = (32, 64, 96)
    """Channels of the stages, the finest first."""
    blocks: tuple[int, int, int] = (1, 2, 2)
    """Number of residual blocks in each stage."""
    head_channels: int = 32
    """Channels of the heads' input maps."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        check_different("classes", self.classes, [entry.name for entry in self.classes])
        check_numbers(self, "at least 1", "channels", "head_channels")
        check_numbers(self, "at least 0", "blocks")


@dataclass(frozen=True, kw_only=True)
class PillarDetectionConfig:
    """Settings for decoding heat maps into boxes."""

    min_heat: float = 0.05
    """Smallest heat of a cell that gives a box."""
    max_cells: int = 2000
    """Number of hottest cells of a sweep that are decoded."""
    max_boxes: int = 100
    """Largest number of boxes for a sweep."""
    suppression_iou: float = 0.1
    """IoU from above beyond which the lower-scored of two boxes of a class is removed."""
    quality_share: float = 0.5
    """Exponent of the predicted IoU in the score; the exponent of the heat is 1 less this."""
    mean_iou: float | None = 0.5
    """IoU from above beyond which boxes of the same class are averaged with a box, weighted by heat
    and predicted IoU. None: no averaging."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        check_numbers(self, "from 0 to 1", "min_heat", "suppression_iou", "quality_share")
        if self.mean_iou is not None and not 0 <= self.mean_iou < 1:
            raise ValueError(f"mean_iou must be None or from 0 to below 1, got {self.mean_iou}")
        check_numbers(self, "at least 1", "max_cells", "max_boxes")
        if self.max_cells * self.max_boxes > _MAX_PAIRS:
            raise ValueError(
                f"max_cells times max_boxes must be up to {_MAX_PAIRS}, got {self.max_cells} "
                f"times {self.max_boxes}"
            )


@dataclass(frozen=True, kw_only=True)
class PillarTargetsConfig:
    """Assignment of cells to objects; shares of the size treat cars and pedestrians alike."""

    heat_share: float = 0.28
    """Standard deviation of the heat around a centre, as a share of sqrt(length x width)."""
    told_length_share: float = 0.5
    """Share of the length about the centre in which cells predict the box."""
    told_width_share: float = 0.6
    """Share of the width about the centre in which cells predict the box."""
    ignored_margin_m: float = 0.3
    """Distance around ignored objects in which the heat does not count."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        shares = ("heat_share", "told_length_share", "told_width_share")
        check_numbers(self, "above 0 and at most 1", *shares)
        check_numbers(self, "finite and not negative", "ignored_margin_m")


@dataclass(frozen=True, kw_only=True)
class PillarLossConfig:
    """Weights of the first stage's losses."""

    heat_weight: float = 1.0
    """Weight of the focal loss."""
    box_weight: float = 1.0
    """Weight of the loss on centre, sizes and axis."""
    corner_weight: float = 2.0
    """Weight of the corner loss."""
    front_weight: float = 2.0
    """Weight of the loss on the front."""
    quality_weight: float = 0.3
    """Weight of the loss on the predicted IoU."""
    knee: float = 0.05
    """Error where the loss changes from quadratic to linear; for corners twice this, in metres."""

    def __post_init__(self) -> None:
        """Check the numbers."""
        weights = (f"{name}_weight" for name in ("heat", "box", "corner", "front", "quality"))
        check_numbers(self, "finite and not negative", *weights)
        check_numbers(self, "positive and finite", "knee")

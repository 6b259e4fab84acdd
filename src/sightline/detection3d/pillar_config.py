"""Settings of the compact first stage: its grid and its network."""

import math
from dataclasses import dataclass, field
from typing import Final

from sightline.detection3d.classes import CAR, CYCLIST, PEDESTRIAN, RoadUserClass

HEAD_STRIDE: Final = 2
"""Length and width of a head cell, in cells of the features."""
_COARSEST_STRIDE: Final = 8  # stride of the backbone's last stage
_MOST_NUMBERS: Final = 2**26  # values in the map: a network then takes 3 GB
_FARTHEST_M: Final = 1e5
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

    def __post_init__(self) -> None:
        """Checks the numbers, and that the backbone can halve the grid in all its stages."""
        if not 0 < self.cell_m < math.inf or not 0 < self.slice_m < math.inf:
            raise ValueError(
                "cell_m and slice_m must be positive and finite, got "
                f"{self.cell_m} and {self.slice_m}"
            )
        if self.slices < 1 or not abs(self.lowest_slice_m) <= _FARTHEST_M:
            raise ValueError(
                f"slices must be at least 1 and lowest_slice_m within {_FARTHEST_M:g}, got "
                f"{self.slices} and {self.lowest_slice_m}"
            )
        for name in ("x_m", "y_m", "z_m"):
            low, high = getattr(self, name)
            if not -_FARTHEST_M <= low < high <= _FARTHEST_M:
                raise ValueError(
                    f"{name} must rise and lie within {_FARTHEST_M:g}, got {low} to {high}"
                )
        self._check_cells()

    def _check_cells(self) -> None:
        x, y = ((high - low) / self.cell_m for low, high in (self.x_m, self.y_m))
        if not x * y * self.channels <= _MOST_NUMBERS:
            raise ValueError(
                f"the grid has {x:.0f} x {y:.0f} cells of {self.channels} numbers, expected up to "
                f"{_MOST_NUMBERS} numbers together; set a larger cell_m, or less ground"
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
        return self.slices + 6 + self.reflectance

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
        """Checks the numbers."""
        if not self.classes or len({entry.name for entry in self.classes}) < len(self.classes):
            raise ValueError(f"classes must hold one or more different ones, got {self.classes}")
        if min(*self.channels, self.head_channels) < 1:
            raise ValueError(
                "channels and head_channels must be at least 1, got "
                f"{self.channels} and {self.head_channels}"
            )
        if min(self.blocks) < 0:
            raise ValueError(f"blocks must not be negative, got {self.blocks}")

"""Settings of the compact second stage: what it sees of a region, and by which network."""

import math
from dataclasses import dataclass

from sightline.detection3d.classes import CAR, CYCLIST, PEDESTRIAN, RoadUserClass


@dataclass(frozen=True, kw_only=True)
class RegionConfig:
    """The compact second stage: one small point network for the regions of all classes."""

    classes: tuple[RoadUserClass, ...] = (CAR, PEDESTRIAN, CYCLIST)
    """What the first stage finds."""
    margin_m: tuple[float, float, float] = (0.8, 0.6, 0.4)
    """How far a region reaches beyond its box in length, width and height, at either end."""
    num_points: int = 192
    """Drawn of each region."""
    in_channels: int = 0
    """Features of each point besides its place: reflectance, mask, or another network's."""
    point_widths: tuple[int, ...] = (64, 96)
    """Layers that each point goes through by itself."""
    region_width: int = 192
    """Of the layer that each point goes through with what the region's points have in common."""
    head_widths: tuple[int, ...] = (192, 128)
    """Layers of the head before its last."""

    def __post_init__(self) -> None:
        """Checks the numbers."""
        if not self.classes or len({entry.name for entry in self.classes}) < len(self.classes):
            raise ValueError(f"classes must hold one or more different ones, got {self.classes}")
        if not all(0 <= margin < math.inf for margin in self.margin_m):
            raise ValueError(f"margin_m must be finite and not negative, got {self.margin_m}")
        if self.num_points < 1 or self.in_channels < 0:
            raise ValueError(
                "num_points must be at least 1 and in_channels not negative, got "
                f"{self.num_points} and {self.in_channels}"
            )
        for name in ("point_widths", "head_widths"):
            widths = getattr(self, name)
            if not widths or min(widths) < 1:
                raise ValueError(f"{name} must hold one positive width a layer, got {widths}")
        if self.region_width < 1:
            raise ValueError(f"region_width must be at least 1, got {self.region_width}")

    @property
    def point_channels(self) -> int:
        """Of what a point of a region tells."""
        return 9 + self.in_channels

    @property
    def context_channels(self) -> int:
        """Of what a region tells as a whole."""
        return 7 + len(self.classes)

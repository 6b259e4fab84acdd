"""Settings of the compact second stage: its regions and its network."""

from dataclasses import dataclass

from sightline.detection3d.classes import CAR, CYCLIST, PEDESTRIAN, RoadUserClass

# Bounds on settings that cost time or memory but add no weights: weights files may come from
# anywhere.
_MOST_PASSES = 10
_MOST_POINTS = 2**14
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
    """Classes for which the result is the mean of the first and last pass (`mean_answer`), because
    the first is closer to the first stage's boxes. Other classes use the last pass."""
    quality_share: float = 0.5
    """Exponent of the last quality in the score; the exponent of the proposal's score is 1 less
    this."""

    def __post_init__(self) -> None:
        """Checks the numbers."""
        if not self.classes or len({entry.name for entry in self.classes}) < len(self.classes):
            raise ValueError(f"classes must hold one or more different ones, got {self.classes}")
        if not all(0 <= margin <= _LARGEST_MARGIN_M for margin in self.margin_m):
            raise ValueError(
                f"margin_m must be from 0 to {_LARGEST_MARGIN_M:g}, got {self.margin_m}"
            )
        if not 1 <= self.num_points <= _MOST_POINTS or self.in_channels < 0:
            raise ValueError(
                f"num_points must be from 1 to {_MOST_POINTS} and in_channels not negative, got "
                f"{self.num_points} and {self.in_channels}"
            )
        for name in ("point_widths", "head_widths"):
            widths = getattr(self, name)
            if not widths or min(widths) < 1:
                raise ValueError(f"{name} must hold one positive width a layer, got {widths}")
        if self.region_width < 1:
            raise ValueError(f"region_width must be at least 1, got {self.region_width}")
        if not 1 <= self.passes <= _MOST_PASSES:
            raise ValueError(f"passes must be from 1 to {_MOST_PASSES}, got {self.passes}")
        unknown = set(self.mean_with_first) - {entry.name for entry in self.classes}
        if unknown:
            raise ValueError(
                f"mean_with_first names {', '.join(sorted(unknown))}, but the classes are "
                f"{', '.join(entry.name for entry in self.classes)}"
            )
        if not 0 <= self.quality_share <= 1:
            raise ValueError(f"quality_share must be from 0 to 1, got {self.quality_share}")

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

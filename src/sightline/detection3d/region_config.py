"""Settings of the compact second stage: what it sees of a region, and by which network."""

from dataclasses import dataclass

from sightline.detection3d.classes import CAR, CYCLIST, PEDESTRIAN, RoadUserClass

# Bounds of what costs time or memory but adds no weights: a file of them may come from anywhere.
_MOST_PASSES = 10
_MOST_POINTS = 2**14
_LARGEST_MARGIN_M = 100.0


@dataclass(frozen=True, kw_only=True)
class RegionConfig:
    """The compact second stage: one small point network for the regions of all classes."""

    classes: tuple[RoadUserClass, ...] = (CAR, PEDESTRIAN, CYCLIST)
    """What the first stage finds, in its order."""
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
    canonical: bool = True
    """Whether points are told in the proposal's frame, with the distances to its faces; else in the
    sweep's."""
    passes: int = 2
    """How often boxes are changed; each pass sees the points around the boxes of the one before."""
    mean_with_first: tuple[str, ...] = ()
    """Of these classes the mean of what the first pass and the last give is answered
    (`mean_answer`): the first still holds some of what the first stage knew. Of others the last."""
    quality_share: float = 0.5
    """Share of the last quality in the score, a product of powers; the proposal has the rest."""

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
        """Of what a point of a region tells."""
        return (9 if self.canonical else 3) + self.in_channels

    @property
    def numbers(self) -> int:
        """That its largest layer gives for a region."""
        return self.num_points * max(self.point_channels, *self.point_widths, self.region_width)

    @property
    def context_channels(self) -> int:
        """Of what a region tells as a whole."""
        return 7 + len(self.classes)

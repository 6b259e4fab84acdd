"""Network settings of both stages; defaults from the published detectors."""

from dataclasses import dataclass
from typing import Final

# Bounds on settings that cost time or memory but add no weights: weights files may come from
# anywhere.
MOST_NUMBERS: Final = 2**29
"""Largest number of values in a layer's output for one sweep: 2 GB."""
_MOST_CENTERS = 2**16
_LARGEST_RADIUS_M = 1000.0


def _check_widths(name: str, widths: tuple[int, ...]) -> None:
    if not widths or min(widths) < 1:
        raise ValueError(f"{name} must hold one positive width a layer, got {widths}")


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
        """Checks the numbers."""
        if not 0 < self.radius_m <= _LARGEST_RADIUS_M:
            raise ValueError(
                f"radius_m must be positive and up to {_LARGEST_RADIUS_M:g}, got {self.radius_m}"
            )
        if self.num_neighbours < 1:
            raise ValueError(f"num_neighbours must be at least 1, got {self.num_neighbours}")
        _check_widths("widths", self.widths)


@dataclass(frozen=True, kw_only=True)
class AbstractionConfig:
    """One level of a point network: fewer points with more features."""

    num_centers: int
    """Number of centres of the level; fewer where the cloud has fewer points."""
    scales: tuple[NeighbourhoodConfig, ...]
    """Neighbourhoods in parallel; their channels are concatenated."""

    def __post_init__(self) -> None:
        """Checks the numbers."""
        if not 1 <= self.num_centers <= _MOST_CENTERS:
            raise ValueError(
                f"num_centers must be from 1 to {_MOST_CENTERS}, got {self.num_centers}"
            )
        if not self.scales:
            raise ValueError("scales must hold one neighbourhood or more, got none")
        if self.numbers > MOST_NUMBERS:
            raise ValueError(
                f"num_centers, num_neighbours and widths make a layer of {self.numbers} numbers, "
                f"expected up to {MOST_NUMBERS}"
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


def _two_scales(
    num_centers: int,
    radii_m: tuple[float, float],
    first: tuple[int, ...],
    second: tuple[int, ...],
) -> AbstractionConfig:
    return AbstractionConfig(
        num_centers=num_centers,
        scales=(
            NeighbourhoodConfig(radius_m=radii_m[0], num_neighbours=16, widths=first),
            NeighbourhoodConfig(radius_m=radii_m[1], num_neighbours=32, widths=second),
        ),
    )


# Defaults in tuples have names so that a run's saved settings can refer to them.
LEVEL_1: Final = _two_scales(4096, (0.1, 0.5), (16, 16, 32), (32, 32, 64))
LEVEL_2: Final = _two_scales(1024, (0.5, 1.0), (64, 64, 128), (64, 96, 128))
LEVEL_3: Final = _two_scales(256, (1.0, 2.0), (128, 196, 256), (128, 196, 256))
LEVEL_4: Final = _two_scales(64, (2.0, 4.0), (256, 256, 512), (256, 384, 512))
REGION_LEVEL_1: Final = AbstractionConfig(
    num_centers=128,
    scales=(NeighbourhoodConfig(radius_m=0.2, num_neighbours=64, widths=(128, 128)),),
)
REGION_LEVEL_2: Final = AbstractionConfig(
    num_centers=32,
    scales=(NeighbourhoodConfig(radius_m=0.4, num_neighbours=64, widths=(128, 256)),),
)


@dataclass(frozen=True, kw_only=True)
class PointBackboneConfig:
    """Settings of PointNet++ (Qi et al. 2017); sizes from Shi et al. 2019 (PointRCNN)."""

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
        """Checks the numbers, and that each level has a propagation."""
        if self.in_channels < 0:
            raise ValueError(f"in_channels must not be negative, got {self.in_channels}")
        if not self.levels or len(self.levels) != len(self.propagation_widths):
            raise ValueError(
                "propagation_widths must hold one entry for each of one or more levels, got "
                f"{len(self.propagation_widths)} for {len(self.levels)}"
            )
        for widths in self.propagation_widths:
            _check_widths("propagation_widths", widths)

    @property
    def out_channels(self) -> int:
        """Number of features of each point."""
        return self.propagation_widths[0][-1]


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

    def __post_init__(self) -> None:
        """Checks the numbers."""
        if self.in_channels < 0:
            raise ValueError(f"in_channels must not be negative, got {self.in_channels}")
        _check_widths("global_widths", self.global_widths)
        if self.head_widths:
            _check_widths("head_widths", self.head_widths)

    def numbers(self, num_points: int) -> int:
        """Compute the size of the largest layer's output for a region of `num_points` points."""
        last = self.levels[-1].num_centers if self.levels else num_points
        levels = (level.numbers for level in self.levels)
        return max(num_points * (3 + self.in_channels), *levels, last * max(self.global_widths))

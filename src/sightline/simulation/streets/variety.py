"""Variety of streets: what other rigs meet beyond KITTI's quiet suburbs by day."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from sightline.simulation.streets.layout import StreetKind

_KIND_SHARES: Final = {
    StreetKind.RESIDENTIAL: 0.22, StreetKind.CITY: 0.38, StreetKind.AVENUE: 0.24,
    StreetKind.COUNTRY: 0.07, StreetKind.SQUARE: 0.09,
}  # fmt: skip
_TOWN: Final = (StreetKind.CITY, StreetKind.AVENUE, StreetKind.SQUARE)
_WET_SHARE, _DUSK_SHARE = 0.22, 0.16
_TALL_SHARE, _GLAZED_SHARE, _WIDE_SHARE = 0.5, 0.5, 0.4
_STANDS_SHARE, _CYCLING_SHARE, _HEAVY_SHARE, _RIDING_SHARE = 0.5, 0.4, 0.5, 0.35
_SITTING_SHARE: Final = 0.4


@dataclass(frozen=True, kw_only=True, slots=True)
class Variety:
    """Differences of one street from KITTI's."""

    kind: StreetKind
    is_tall: bool
    """Whether its blocks have six to fifteen storeys."""
    glazed_share: float
    """Share of larger buildings with fronts of mirroring glass."""
    has_wide_junction: bool
    """Whether it crosses an avenue of several lanes at large corners."""
    bicycle_rows: float
    """Mean number of rows of parked bicycles along each side of a road."""
    cyclists: float
    """Factor on the mean number of cyclists."""
    heavy: float
    """Factor on the share of lorries and buses."""
    motorcycles: float
    """Mean number of motorcycles that are ridden, and of groups of parked ones."""
    sitting: float
    """Mean number of groups of sitting people."""
    is_wet: bool
    """Whether roads and pavements are wet."""
    is_dusk: bool
    """Whether it is nearly night, with lamps lit."""


def draw_variety(rng: np.random.Generator) -> Variety:
    """Draw the variety of a street; a few differences at a time are usual, all are possible."""
    kinds = list(_KIND_SHARES)
    kind = kinds[int(rng.choice(len(kinds), p=list(_KIND_SHARES.values())))]
    in_town = kind in _TOWN

    def some(share: float, low: float, high: float, otherwise: float) -> float:
        """Draw a number between two, with a probability."""
        number = float(rng.uniform(low, high))
        return number if rng.random() < share else otherwise

    return Variety(
        kind=kind,
        is_tall=bool(rng.random() < _TALL_SHARE) and in_town,
        glazed_share=some(_GLAZED_SHARE, 0.15, 0.8, 0.0) if in_town else 0.0,
        has_wide_junction=bool(rng.random() < _WIDE_SHARE)
        and kind in (StreetKind.CITY, StreetKind.AVENUE),
        bicycle_rows=some(_STANDS_SHARE, 0.4, 2.5, 0.0),
        cyclists=some(_CYCLING_SHARE, 3.0, 14.0, 1.0),
        heavy=some(_HEAVY_SHARE, 1.5, 6.0, 1.0),
        motorcycles=some(_RIDING_SHARE, 0.5, 3.0, 0.1),
        sitting=some(_SITTING_SHARE, 0.5, 3.0, 0.0),
        is_wet=bool(rng.random() < _WET_SHARE),
        is_dusk=bool(rng.random() < _DUSK_SHARE),
    )

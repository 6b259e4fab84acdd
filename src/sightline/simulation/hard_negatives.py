"""Placement of hard negatives, far more frequent than in real streets.

These are objects on which detectors trained only on simulated streets give false positives in real
ones: beacons and heaps of road works, low signs, masts, bins and bushes.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from jaxtyping import Float, Float64

from sightline.simulation.layout import Layout, Road, Side
from sightline.simulation.meshes.furniture import Item, item_footprint
from sightline.simulation.meshes.trees import Plants, Species
from sightline.simulation.setting_out import Things

_AT_KERB: Final = (
    Item.KEEP_RIGHT_SIGN, Item.CHEVRONS, Item.SIGNAL_MAST, Item.POSTER_POLE, Item.DISPLAY_STAND,
    Item.LITTER_BIN, Item.PARKING_METER, Item.STAKED_TREE, Item.BOLLARD, Item.BIN,
)  # fmt: skip
_AT_PLOTS: Final = (
    Item.POSTER_POLE, Item.DISPLAY_STAND, Item.LITTER_BIN, Item.BARE_TRUNK, Item.LEANING_TRUNKS,
    Item.STACK_OF_PALLETS, Item.PILLAR, Item.HYDRANT, Item.CONTAINER, Item.SAND_HEAP,
    Item.WHEELED_BIN,
)  # fmt: skip
_IN_THE_MIDDLE: Final = (Item.KEEP_RIGHT_SIGN, Item.CHEVRONS, Item.SIGNAL_MAST, Item.BEACON)
_NUM_KINDS: Final = 3.0
"""Mean number of kinds of objects at a kerb, and the same at its plots."""
_FIRST_M, _LAST_M = -5.0, 65.0
"""Range of stations of objects along the main road; half as far on either arm of another road."""
_WORKS_SHARE: Final = 0.4
"""Share of streets with road works."""
_NUM_SLENDER, _NUM_BROAD = 4.0, 3.0
"""Mean numbers of slender and broad bushes on each side of a road."""
_SLENDER_HEIGHTS_M: Final = (0.9, 2.1)
_SLENDER_SPREADS: Final = (0.28, 0.6)
_BROAD_HEIGHTS_M: Final = (1.0, 2.0)
_BROAD_SPREADS: Final = (0.9, 1.8)
_FOOT_HEIGHTS_M: Final = (0.4, 0.9)
_FOOT_SPREADS: Final = (0.5, 0.85)
"""Spreads of bushes around trunks, small enough for the ground kept free around them."""
_BUSH_WIDTH: Final = 1.6
"""Maximum width of a bush of spread 1, in heights, except for a few twigs."""
_WIDEST: Final = 1.3
"""Maximum factor of horizontal stretching."""
_GARDEN_M: Final = 0.7
"""Distance behind the last band, beyond hedges and fences."""


def set_out_hard_negatives(
    rng: np.random.Generator,
    layout: Layout,
    things: Things,
    trunks: Sequence[Float64[np.ndarray, "_ 3"]],
) -> None:
    """Add hard negatives to a street with furniture; none overlaps a road user or a house.

    Args:
        rng: Source of all randomness.
        layout: The street.
        things: Objects placed so far; extended in place.
        trunks: Places of the trees in rows, which get bushes around them.
    """
    planter = _Planter(rng, layout, things)
    for road in layout.roads:
        for side in road.sides:
            planter.line_kerb(road, side)
            planter.line_plots(road, side)
            planter.shrubs(road, side)
        planter.middle(road)
    if rng.random() < _WORKS_SHARE:
        planter.road_works(layout.main.left if rng.random() < 0.5 else layout.main.right)
    for row in trunks:
        planter.bushes(row[rng.random(len(row)) < rng.uniform(0.0, 0.7)])


class _Planter:
    """Placer of hard negatives in one street."""

    def __init__(self, rng: np.random.Generator, layout: Layout, things: Things) -> None:
        self._rng = rng
        self._layout = layout
        self._things = things

    def line_kerb(self, road: Road, side: Side) -> None:
        """Place signs, masts, bins and similar objects at the edge of the carriageway."""
        for item in self._drawn(_AT_KERB):
            clear = side.edge + _reach(item)
            self._put(item, road, side, clear + float(self._rng.uniform(0.0, 0.6)))

    def line_plots(self, road: Road, side: Side) -> None:
        """Place trunks, heaps, stacks and the like on the bands or behind hedges and fences."""
        for item in self._drawn(_AT_PLOTS):
            reach = _reach(item)
            inner, outer = side.edge + reach, side.outer - reach
            if inner > outer or self._rng.random() < 0.4:
                inner, outer = side.outer + _GARDEN_M + reach, side.outer + _GARDEN_M + reach + 2.0
            self._put(item, road, side, float(self._rng.uniform(inner, outer)))

    def middle(self, road: Road) -> None:
        """Place signs and masts between lanes of opposite directions."""
        ahead = [lane.offset for lane in road.lanes if lane.direction > 0]
        against = [lane.offset for lane in road.lanes if lane.direction < 0]
        if not ahead or not against:
            return
        between = (max(ahead) + min(against)) / 2
        closed = replace(road.left, gaps=road.left.gaps + road.right.gaps)
        for item in self._drawn(_IN_THE_MIDDLE, mean=0.7):
            self._put(item, road, closed, between)

    def road_works(self, side: Side) -> None:
        """Place a row of beacons on the carriageway, with heaps and stacks behind it."""
        rng, main = self._rng, self._layout.main
        start, length = float(rng.uniform(2.0, 40.0)), float(rng.uniform(6.0, 40.0))
        stations = np.arange(start, start + length, float(rng.uniform(1.5, 6.0)))
        item = Item.LIT_BEACON if rng.random() < 0.5 else Item.BEACON
        distance = side.lane_edge - float(rng.uniform(-0.4, 0.5))
        self._set(item, main, side, stations, distance, turn=np.pi if rng.random() < 0.5 else 0.0)
        heaps = (Item.SAND_HEAP, Item.GRAVEL_HEAP, Item.STACK_OF_PALLETS, Item.SKIP, Item.BARRIER)
        for heap in self._drawn(heaps):
            behind = max(distance + 0.5, side.lane_edge) + _reach(heap)
            self._put(heap, main, side, behind + float(rng.uniform(0.0, 2.0)))

    def shrubs(self, road: Road, side: Side) -> None:
        """Place bushes as slender as people and as large as cars, beyond the last band."""
        kinds = (
            (_NUM_SLENDER, _SLENDER_HEIGHTS_M, _SLENDER_SPREADS),
            (_NUM_BROAD, _BROAD_HEIGHTS_M, _BROAD_SPREADS),
        )
        for mean, heights, spreads in kinds:
            stations = self._stations(road, int(self._rng.poisson(mean)))
            for station in self._things.free_stations(road, side, stations, 1.0):
                height, spread = self._rng.uniform(*heights), self._rng.uniform(*spreads)
                wide = _BUSH_WIDTH * height * spread
                distance = side.outer + _GARDEN_M + wide / 2 + self._rng.uniform(0.0, 2.5)
                place = self._things.on_surface(road, np.array([station]), side.sign * distance)
                row = np.concatenate((place, np.zeros((1, 1))), axis=1)
                if self._things.settle(row, wide, wide).all():
                    plants = Plants(places=place, heights=np.array([height]), spread=float(spread))
                    self._things.plant(Species.BUSH, plants)

    def bushes(self, places: Float64[np.ndarray, "count 3"]) -> None:
        """Place bushes around trunks, or shoots from their feet."""
        heights = self._rng.uniform(*_FOOT_HEIGHTS_M, len(places))
        spread = float(self._rng.uniform(*_FOOT_SPREADS))
        plants = Plants(places=places, heights=heights, spread=spread)
        self._things.plant(Species.BUSH, plants)

    def _drawn(self, items: Sequence[Item], mean: float = _NUM_KINDS) -> list[Item]:
        """Draw some of the items, without repetition."""
        count = min(int(self._rng.poisson(mean)), len(items))
        return [items[row] for row in self._rng.choice(len(items), count, replace=False)]

    def _stations(self, road: Road, count: int) -> Float64[np.ndarray, " count"]:
        """Draw stations for objects."""
        if road is self._layout.main:
            return self._rng.uniform(_FIRST_M, _LAST_M, count)
        return self._rng.uniform(-_LAST_M / 2, _LAST_M / 2, count)

    def _put(self, item: Item, road: Road, side: Side, distance: float) -> None:
        """Place one to three objects of a kind somewhere along a road, at any heading."""
        stations = self._stations(road, int(self._rng.integers(1, 4)))
        turn = float(self._rng.uniform(-np.pi, np.pi))
        self._set(item, road, side, stations, distance, turn)

    def _set(
        self,
        item: Item,
        road: Road,
        side: Side,
        stations: Float[np.ndarray, " count"],
        distance: float,
        turn: float,
    ) -> None:
        """Place objects at stations, all stretched alike, on the carriageway or the pavement."""
        wide, high = self._rng.uniform(0.8, _WIDEST), self._rng.uniform(0.85, 1.2)
        free = self._things.free_stations(road, side, stations, 1.0)
        offset = side.sign * distance
        self._things.put(item, road, free, offset, None, turn, scale=(wide, wide, high))


def _reach(item: Item) -> float:
    """Compute the radius [m] of an object at maximum stretch, for any heading."""
    return _WIDEST * float(np.hypot(*item_footprint(item))) / 2

"""Placement of street furniture, rows of trees and objects mistaken for people or cars."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from jaxtyping import Float64

from sightline.simulation.arrays import AnyValues, Points
from sightline.simulation.scene import Material, Mesh
from sightline.simulation.shapes.edits import QuadBatch
from sightline.simulation.shapes.primitives import Finish
from sightline.simulation.streets.bicycle_rows import park_bicycles
from sightline.simulation.streets.free_ground import Occupancy, StreetObjects
from sightline.simulation.streets.layout import (
    Ground,
    Layout,
    Parking,
    Plots,
    Road,
    Side,
    StreetKind,
    ground_places,
)
from sightline.simulation.streets.markings import stop_lines
from sightline.simulation.surroundings.boundaries import add_boxes_along, add_posts
from sightline.simulation.surroundings.furniture import Item, item_footprint
from sightline.simulation.surroundings.trees import Plants, Species

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
_NUM_KINDS: Final = 3.0  # mean number of kinds of objects at a kerb, and the same at its plots
_FIRST_M, _LAST_M = -5.0, 65.0
"""Range of stations of objects along the main road; half as far on either arm of another road."""
_WORKS_SHARE: Final = 0.4  # share of streets with road works
_SHRUBS: Final = ((4.0, (0.9, 2.1), (0.28, 0.6)), (3.0, (1.0, 2.0), (0.9, 1.8)))
"""Mean number on each side of a road, heights [m] and spreads of slender and broad bushes."""
_FOOT_HEIGHTS_M: Final = (0.4, 0.9)
_FOOT_SPREADS: Final = (0.5, 0.85)
"""Spreads of bushes around trunks, small enough for the ground kept free around them."""
_BUSH_WIDTH: Final = 1.6  # maximum width of a bush of spread 1, in heights, except for a few twigs
_WIDEST: Final = 1.3  # maximum factor of horizontal stretching
_GARDEN_M: Final = 0.7  # distance behind the last band, beyond hedges and fences


def set_out_hard_negatives(
    rng: np.random.Generator,
    layout: Layout,
    objects: StreetObjects,
    trunks: Sequence[Float64[np.ndarray, "_ 3"]],
) -> None:
    """Add hard negatives to a street with furniture; none overlaps a road user or a house.

    They extend `objects`; `trunks`, places of the trees in rows, get bushes around them.
    """
    planter = _Planter(rng, layout, objects)
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

    def __init__(self, rng: np.random.Generator, layout: Layout, objects: StreetObjects) -> None:
        self._rng = rng
        self._layout = layout
        self._objects = objects

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
        for mean, heights, spreads in _SHRUBS:
            stations = self._stations(road, int(self._rng.poisson(mean)))
            for station in self._objects.free_stations(road, side, stations, 1.0):
                height, spread = self._rng.uniform(*heights), self._rng.uniform(*spreads)
                wide = _BUSH_WIDTH * height * spread
                distance = side.outer + _GARDEN_M + wide / 2 + self._rng.uniform(0.0, 2.5)
                place = self._objects.on_surface(road, np.array([station]), side.sign * distance)
                row = np.concatenate((place, np.zeros((1, 1))), axis=1)
                if self._objects.settle(row, wide, wide).all():
                    plants = Plants(places=place, heights=np.array([height]), spread=float(spread))
                    self._objects.plant(Species.BUSH, plants)

    def bushes(self, places: Points) -> None:
        """Place bushes around trunks, or shoots from their feet."""
        heights = self._rng.uniform(*_FOOT_HEIGHTS_M, len(places))
        spread = float(self._rng.uniform(*_FOOT_SPREADS))
        plants = Plants(places=places, heights=heights, spread=spread)
        self._objects.plant(Species.BUSH, plants)

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
        self, item: Item, road: Road, side: Side, stations: AnyValues, distance: float, turn: float
    ) -> None:
        """Place objects at stations, all stretched alike, on the carriageway or the pavement."""
        wide, high = self._rng.uniform(0.8, _WIDEST), self._rng.uniform(0.85, 1.2)
        free = self._objects.free_stations(road, side, stations, 1.0)
        offset = side.sign * distance
        self._objects.put(item, road, free, offset, None, turn, scale=(wide, wide, high))


def _reach(item: Item) -> float:
    """Compute the radius [m] of an object at maximum stretch, for any heading."""
    return _WIDEST * float(np.hypot(*item_footprint(item))) / 2


_KERB_CLEARANCE: Final = 0.55
_TRUNK_M: Final = 0.5
_SITE_SHARE: Final = 0.12  # share of streets with a building site
_ALONG: Final = (Item.PARKING_SIGN, Item.NO_PARKING_SIGN, Item.BICYCLE, Item.POSTER)
"""Items that face along the street instead of towards it."""
_ROW_TREES: Final = (Species.PLANE, Species.LIME, Species.CHERRY, Species.BIRCH, Species.POPLAR)


def dress(
    rng: np.random.Generator,
    layout: Layout,
    taken: Occupancy,
    *,
    hard_negatives: bool = False,
    bicycle_rows: float = 0.0,
) -> list[Mesh]:
    """Place all furniture and rows of trees of a street, clear of road users and walls.

    `hard_negatives` adds objects easily mistaken for a person or a car, and `bicycle_rows` is the
    mean number of rows of parked bicycles on each side of a road; all extend `taken`.
    """
    dresser = _Dresser(rng, layout, taken)
    if layout.junction is not None:  # lights and priority signs take precedence
        dresser.junction()
    for road in layout.roads:
        for side in road.sides:
            dresser.trees(road, side)
            if layout.kind is StreetKind.COUNTRY:
                dresser.country_side(road, side)
            else:
                dresser.lamps(road, side)
                dresser.small_objects(road, side)
    if layout.kind is StreetKind.SQUARE:
        dresser.square()
    dresser.signs()
    if rng.random() < _SITE_SHARE:
        dresser.building_site(layout.main.left if rng.random() < 0.5 else layout.main.right)
    if hard_negatives:
        set_out_hard_negatives(rng, layout, dresser.objects, dresser.trunks)
    bicycles = park_bicycles(rng, layout, dresser.objects, bicycle_rows) if bicycle_rows else []
    return [*dresser.meshes(), *bicycles]


class _Dresser:
    """Collector of object places that makes their meshes at the end."""

    def __init__(self, rng: np.random.Generator, layout: Layout, taken: Occupancy) -> None:
        self._rng = rng
        self._layout = layout
        self.objects = StreetObjects(rng, layout, taken)
        self.trunks: list[Float64[np.ndarray, "_ 3"]] = []
        """Places of the trees in rows."""
        self._batch = QuadBatch()
        self._lamp = Item.POST_LAMP if rng.random() < 0.35 else Item.ARM_LAMP
        self._tree = _ROW_TREES[int(rng.integers(len(_ROW_TREES)))]

    def meshes(self) -> list[Mesh]:
        """Make the meshes of everything placed so far."""
        return [*self.objects.meshes(), self._batch.mesh()]

    def trees(self, road: Road, side: Side) -> None:
        """Place a row of equal trees on the verge or at the pavement's edge."""
        if not side.has_tree_row:
            return
        rng = self._rng
        verge = side.band(Ground.VERGE)
        if verge is not None:
            distance = (verge.inner + verge.outer) / 2
        elif self._layout.kind is StreetKind.COUNTRY:
            distance = side.outer + 1.2
        else:
            distance = side.edge + 0.9
        pitch = float(rng.uniform(6.5, 12.0))
        first = road.first + float(rng.uniform(0, pitch))
        stations = self.objects.free_stations(road, side, np.arange(first, road.last, pitch), 1.0)
        stations = stations[rng.random(len(stations)) < 0.9]
        stations = stations + rng.uniform(-0.6, 0.6, len(stations))
        places = ground_places(self._layout, road, stations, side.sign * distance, side.level)
        rows = np.concatenate((places, np.zeros((len(places), 1))), axis=1)
        places = places[self.objects.settle(rows, _TRUNK_M, _TRUNK_M)]
        usual = {Species.CHERRY: 5.5, Species.BIRCH: 10.0, Species.POPLAR: 14.0}.get(
            self._tree, 11.5
        )
        heights = usual * rng.uniform(0.8, 1.15) * rng.uniform(0.88, 1.1, len(places))
        self.trunks.append(places)
        self.objects.plant(self._tree, Plants(places=places, heights=heights, spread=1.0))

    def lamps(self, road: Road, side: Side) -> None:
        """Place lamps along the kerb, on both sides or one."""
        rng = self._rng
        one_sided = self._layout.kind is StreetKind.RESIDENTIAL
        if one_sided and side.sign > 0 and rng.random() < 0.7:
            return
        pitch = 22.0 if self._lamp is Item.POST_LAMP else 31.0
        first = road.first + float(rng.uniform(0, pitch))
        stations = self.objects.free_stations(road, side, np.arange(first, road.last, pitch), 0.5)
        distance = side.edge + _KERB_CLEARANCE
        turn = -side.sign * np.pi / 2
        self.objects.put(self._lamp, road, stations, side.sign * distance, side.level, turn)

    def small_objects(self, road: Road, side: Side) -> None:
        """Place bollards, bins, boards and similar items at the kerb or beside the plots."""
        rng = self._rng
        at_kerb = (
            (Item.BOLLARD, 0.15), (Item.BIN, 0.35), (Item.PARKING_SIGN, 0.35),
            (Item.NO_PARKING_SIGN, 0.3), (Item.BICYCLE_STAND, 0.2), (Item.POSTER, 0.1),
            (Item.HYDRANT, 0.15),
        )  # fmt: skip
        at_plots: tuple[tuple[Item, float], ...] = (
            (Item.CABINET, 0.5), (Item.LETTER_BOX, 0.15), (Item.WHEELED_BIN, 0.45),
            (Item.BENCH, 0.15), (Item.SHELTER, 0.08), (Item.ADVERT_COLUMN, 0.06),
            (Item.BICYCLE, 0.25), (Item.PILLAR, 0.2), (Item.GRIT_BOX, 0.1),
            (Item.BOTTLE_BANK, 0.06),
        )  # fmt: skip
        if self._layout.kind in (StreetKind.CITY, StreetKind.SQUARE):
            at_plots = (*at_plots, (Item.PLANTER, 0.5), (Item.SANDWICH_BOARD, 0.4))
        for objects, is_at_kerb in ((at_kerb, True), (at_plots, False)):
            for item, chance in objects:
                if rng.random() >= chance:
                    continue
                stations = rng.uniform(-10.0, 70.0, int(rng.integers(1, 4)))
                if item is Item.BOLLARD:
                    stations = stations[0] + 1.6 * np.arange(int(rng.integers(4, 14)))
                elif item is Item.WHEELED_BIN:
                    stations = (stations[:, None] + 0.65 * np.arange(3)).ravel()
                turn = -side.sign * np.pi / 2
                if item in _ALONG:
                    turn = 0.0 if side.sign > 0 else np.pi
                deep = item_footprint(item)[1 if item in _ALONG else 0] / 2
                distance = side.edge + 0.4 + deep if is_at_kerb else side.outer - 0.15 - deep
                free = self.objects.free_stations(road, side, stations, 1.0)
                kept = self.objects.put(item, road, free, side.sign * distance, side.level, turn)
                if item is Item.BICYCLE_STAND:
                    self._bicycles(road, side, kept, distance)

    def _bicycles(self, road: Road, side: Side, stands: AnyValues, distance: float) -> None:
        """Place bicycles at most hoops of stands, with either wheel towards the road."""
        hoops = (stands[:, None] + 0.8 * (np.arange(4) - 1.5) + 0.22).ravel()
        hoops = hoops[self._rng.random(len(hoops)) < 0.7]
        places = ground_places(self._layout, road, hoops, side.sign * distance, side.level)
        turns = np.where(self._rng.random(len(hoops)) < 0.5, 0.5, -0.5) * np.pi
        turns += road.line.yaw(hoops) + self._rng.normal(0, 0.06, len(hoops))
        rows = np.concatenate((places, turns[:, None]), axis=1)
        self.objects.add(Item.BICYCLE, rows)

    def building_site(self, side: Side) -> None:
        """Place barriers and cones along the kerb, with a building site behind them."""
        rng, main = self._rng, self._layout.main
        start = float(rng.uniform(4.0, 45.0))
        stop = start + float(rng.uniform(8.0, 22.0))
        facing = -side.sign * np.pi / 2

        def set_out(item: Item, stations: AnyValues, distance: float) -> None:
            level = side.level if distance > side.edge else 0.0
            free = self.objects.free_stations(main, side, stations, 1.0)
            self.objects.put(item, main, free, side.sign * distance, level, facing)

        middle = np.array([(start + stop) / 2 + rng.uniform(-2.0, 2.0)])
        if side.plots in (Plots.BLOCKS, Plots.TERRACES) and side.setback < 2.0:
            set_out(Item.SCAFFOLD, middle, side.outer + side.setback - 0.6)
        elif side.plots in (Plots.PARK, Plots.FIELD, Plots.HALLS):
            set_out(Item.SITE_CABIN, middle, side.outer + 1.8)
        if side.parking is Parking.PARALLEL:
            set_out(Item.SKIP, np.array([start + 3.0]), side.edge - 1.0)
        set_out(Item.BARRIER, np.arange(start, stop, 2.05), side.edge + 0.45)
        set_out(Item.CONE, np.arange(start - 12.0, start, 3.0), side.edge - 0.25)

    def country_side(self, road: Road, side: Side) -> None:
        """Place delineators, sometimes a guard rail or a line of poles."""
        rng = self._rng
        distance = side.edge + 0.6
        stations = np.arange(road.first + 6.0, road.last, 25.0 if rng.random() < 0.5 else 50.0)
        free = self.objects.free_stations(road, side, stations, 2.0)
        self.objects.put(Item.DELINEATOR, road, free, side.sign * distance, side.level, 0.0)
        if rng.random() < 0.3 and road is self._layout.main:
            for start, stop in side.stretches(max(road.first, -40.0), road.last, 6.0):
                self._guard_rail(road, side, np.arange(start, stop, 4.0))
        if rng.random() < 0.25:
            poles = self.objects.free_stations(
                road, side, np.arange(road.first, road.last, 38.0), 3.0
            )
            far = side.sign * (side.outer + 3.5)
            self.objects.put(Item.WIRE_POLE, road, poles, far, -0.1, 0.0)

    def _guard_rail(self, road: Road, side: Side, stations: AnyValues) -> None:
        if len(stations) < 2:
            return
        zinc = Finish(Material.METAL, (0.42, 0.43, 0.44))
        offset = side.sign * (side.edge + 0.95)
        line = ground_places(self._layout, road, stations, offset, side.level)
        for low, wide in ((0.44, 0.03), (0.52, 0.012), (0.66, 0.03)):
            add_boxes_along(self._batch, line, zinc, half_width=wide, heights=(low, low + 0.09))
        behind = ground_places(
            self._layout, road, stations, offset + side.sign * 0.1, side.level - 0.1
        )
        add_posts(self._batch, behind, road.line.yaw(stations), (0.05, 0.03, 0.38), zinc)

    def square(self) -> None:
        """Place benches, trees in planters and bollards in a pedestrian zone."""
        rng, main = self._rng, self._layout.main
        for side in main.sides:
            width = side.outer - side.edge
            for item, chance in (
                (Item.BENCH, 0.7), (Item.PLANTER, 0.6), (Item.BICYCLE_STAND, 0.4),
                (Item.PARASOL, 0.3),
            ):  # fmt: skip
                if rng.random() < chance and width > 4.0:
                    stations = np.arange(rng.uniform(-5, 8), 70.0, rng.uniform(9.0, 18.0))
                    turn = -side.sign * np.pi / 2
                    distance = side.edge + (2.4 if item is Item.PARASOL else 0.6)
                    kept = self.objects.put(item, main, stations, side.sign * distance, 0.0, turn)
                    if item is Item.BICYCLE_STAND:
                        self._bicycles(main, side, kept, distance)

    def signs(self) -> None:
        """Place signs beside the main road."""
        rng, main = self._rng, self._layout.main
        if self._layout.kind is StreetKind.SQUARE:
            return
        common = (Item.SPEED_SIGN, Item.PRIORITY_SIGN, Item.NO_PARKING_SIGN, Item.PATH_SIGN)
        for side in main.sides:
            count = int(rng.integers(1, 4))
            stations = self.objects.free_stations(main, side, rng.uniform(2.0, 100.0, count), 1.0)
            turn = 0.0 if side.sign > 0 else np.pi
            for station in stations:
                item = common[int(rng.integers(len(common)))]
                distance = side.sign * (side.edge + 0.65)
                self.objects.put(item, main, np.array([station]), distance, side.level, turn)
        is_wide = self._layout.kind in (StreetKind.AVENUE, StreetKind.COUNTRY)
        if is_wide and rng.random() < 0.35:
            side = main.right
            if side.plots is not Plots.BLOCKS:
                spot = self.objects.free_stations(main, side, rng.uniform(20.0, 80.0, 1), 3.0)
                distance = -(side.edge + 2.2)
                self.objects.put(Item.DIRECTION_SIGN, main, spot, distance, side.level, np.pi)
        for side in main.sides:
            if side.setback > 3.5 and rng.random() < 0.12:
                spot = self.objects.free_stations(main, side, rng.uniform(15.0, 80.0, 1), 3.0)
                distance = side.sign * (side.outer + 2.4)
                turn = np.pi + side.sign * float(rng.uniform(0.1, 0.7))
                self.objects.put(Item.BILLBOARD, main, spot, distance, side.level, turn)

    def junction(self) -> None:
        """Place lights or priority signs at each stop line, and a street name at a corner."""
        layout, junction = self._layout, self._layout.junction
        assert junction is not None, "called for streets with a junction only"
        for road in layout.roads:
            for station, direction in stop_lines(layout, road):
                side = road.right if direction > 0 else road.left
                turn = np.pi if direction > 0 else 0.0
                distance = side.sign * (side.edge + 0.5)
                spot = np.array([station])
                if junction.has_lights:
                    self.objects.put(Item.TRAFFIC_LIGHT, road, spot, distance, side.level, turn)
                elif road is junction.cross:
                    item = Item.YIELD_SIGN if self._rng.random() < 0.75 else Item.STOP_SIGN
                    self.objects.put(item, road, spot, distance, side.level, turn)
                if layout.kind is not StreetKind.COUNTRY:
                    corner = side.sign * (side.edge + 1.2)
                    ahead = np.array([station + direction * 1.5])
                    self.objects.put(Item.NAME_SIGN, road, ahead, corner, side.level, np.pi / 2)

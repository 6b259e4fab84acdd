"""Placement of street furniture: rows of trees, lamps, signs, lights, bollards, rails."""

from typing import Final

import numpy as np
from jaxtyping import Float, Float64

from sightline.simulation.hard_negatives import set_out_hard_negatives
from sightline.simulation.layout import (
    Ground,
    Layout,
    Parking,
    Plots,
    Road,
    Side,
    StreetKind,
    ground_places,
)
from sightline.simulation.materials import Material
from sightline.simulation.meshes.batches import QuadBatch
from sightline.simulation.meshes.furniture import (
    Item,
    add_boxes_along,
    add_posts,
    item_footprint,
)
from sightline.simulation.meshes.markings import stop_lines
from sightline.simulation.meshes.primitives import Finish
from sightline.simulation.meshes.trees import Plants, Species
from sightline.simulation.occupancy import Occupancy
from sightline.simulation.scene import Mesh
from sightline.simulation.setting_out import Things

_KERB_CLEARANCE: Final = 0.55
_TRUNK_M: Final = 0.5
_SITE_SHARE: Final = 0.12
"""Share of streets with a building site."""
_ALONG: Final = (Item.PARKING_SIGN, Item.NO_PARKING_SIGN, Item.BICYCLE, Item.POSTER)
"""Items that face along the street instead of towards it."""
_ROW_TREES: Final = (Species.PLANE, Species.LIME, Species.CHERRY, Species.BIRCH, Species.POPLAR)


def dress(
    rng: np.random.Generator, layout: Layout, taken: Occupancy, *, hard_negatives: bool = False
) -> list[Mesh]:
    """Place all furniture and rows of trees of a street, clear of road users and walls.

    Args:
        rng: Source of all randomness.
        layout: The street.
        taken: Occupied ground; extended in place.
        hard_negatives: Whether to add objects easily mistaken for a person or a car.
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
                dresser.small_things(road, side)
    if layout.kind is StreetKind.SQUARE:
        dresser.square()
    dresser.signs()
    if rng.random() < _SITE_SHARE:
        dresser.building_site(layout.main.left if rng.random() < 0.5 else layout.main.right)
    if hard_negatives:
        set_out_hard_negatives(rng, layout, dresser.things, dresser.trunks)
    return dresser.meshes()


class _Dresser:
    """Collector of object places that makes their meshes at the end."""

    def __init__(self, rng: np.random.Generator, layout: Layout, taken: Occupancy) -> None:
        self._rng = rng
        self._layout = layout
        self.things = Things(rng, layout, taken)
        self.trunks: list[Float64[np.ndarray, "_ 3"]] = []
        """Places of the trees in rows."""
        self._batch = QuadBatch()
        self._lamp = Item.POST_LAMP if rng.random() < 0.35 else Item.ARM_LAMP
        self._tree = _ROW_TREES[int(rng.integers(len(_ROW_TREES)))]

    def meshes(self) -> list[Mesh]:
        """Make the meshes of everything placed so far."""
        return [*self.things.meshes(), self._batch.mesh()]

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
        stations = self.things.free_stations(road, side, np.arange(first, road.last, pitch), 1.0)
        stations = stations[rng.random(len(stations)) < 0.9]
        stations = stations + rng.uniform(-0.6, 0.6, len(stations))
        places = ground_places(self._layout, road, stations, side.sign * distance, side.level)
        rows = np.concatenate((places, np.zeros((len(places), 1))), axis=1)
        places = places[self.things.settle(rows, _TRUNK_M, _TRUNK_M)]
        usual = {Species.CHERRY: 5.5, Species.BIRCH: 10.0, Species.POPLAR: 14.0}.get(
            self._tree, 11.5
        )
        heights = usual * rng.uniform(0.8, 1.15) * rng.uniform(0.88, 1.1, len(places))
        self.trunks.append(places)
        self.things.plant(self._tree, Plants(places=places, heights=heights, spread=1.0))

    def lamps(self, road: Road, side: Side) -> None:
        """Place lamps along the kerb, on both sides or one."""
        rng = self._rng
        one_sided = self._layout.kind is StreetKind.RESIDENTIAL
        if one_sided and side.sign > 0 and rng.random() < 0.7:
            return
        pitch = 22.0 if self._lamp is Item.POST_LAMP else 31.0
        first = road.first + float(rng.uniform(0, pitch))
        stations = self.things.free_stations(road, side, np.arange(first, road.last, pitch), 0.5)
        distance = side.edge + _KERB_CLEARANCE
        turn = -side.sign * np.pi / 2
        self.things.put(self._lamp, road, stations, side.sign * distance, side.level, turn)

    def small_things(self, road: Road, side: Side) -> None:
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
        for things, is_at_kerb in ((at_kerb, True), (at_plots, False)):
            for item, chance in things:
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
                free = self.things.free_stations(road, side, stations, 1.0)
                kept = self.things.put(item, road, free, side.sign * distance, side.level, turn)
                if item is Item.BICYCLE_STAND:
                    self._bicycles(road, side, kept, distance)

    def _bicycles(
        self, road: Road, side: Side, stands: Float[np.ndarray, " count"], distance: float
    ) -> None:
        """Place bicycles at most hoops of stands, with either wheel towards the road."""
        hoops = (stands[:, None] + 0.8 * (np.arange(4) - 1.5) + 0.22).ravel()
        hoops = hoops[self._rng.random(len(hoops)) < 0.7]
        places = ground_places(self._layout, road, hoops, side.sign * distance, side.level)
        turns = np.where(self._rng.random(len(hoops)) < 0.5, 0.5, -0.5) * np.pi
        turns += road.line.yaw(hoops) + self._rng.normal(0, 0.06, len(hoops))
        rows = np.concatenate((places, turns[:, None]), axis=1)
        self.things.add(Item.BICYCLE, rows)

    def building_site(self, side: Side) -> None:
        """Place barriers and cones along the kerb, with a building site behind them."""
        rng, main = self._rng, self._layout.main
        start = float(rng.uniform(4.0, 45.0))
        stop = start + float(rng.uniform(8.0, 22.0))
        facing = -side.sign * np.pi / 2

        def set_out(item: Item, stations: Float[np.ndarray, " count"], distance: float) -> None:
            level = side.level if distance > side.edge else 0.0
            free = self.things.free_stations(main, side, stations, 1.0)
            self.things.put(item, main, free, side.sign * distance, level, facing)

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
        free = self.things.free_stations(road, side, stations, 2.0)
        self.things.put(Item.DELINEATOR, road, free, side.sign * distance, side.level, 0.0)
        if rng.random() < 0.3 and road is self._layout.main:
            for start, stop in side.stretches(max(road.first, -40.0), road.last, 6.0):
                self._guard_rail(road, side, np.arange(start, stop, 4.0))
        if rng.random() < 0.25:
            poles = self.things.free_stations(
                road, side, np.arange(road.first, road.last, 38.0), 3.0
            )
            far = side.sign * (side.outer + 3.5)
            self.things.put(Item.WIRE_POLE, road, poles, far, -0.1, 0.0)

    def _guard_rail(self, road: Road, side: Side, stations: Float[np.ndarray, " count"]) -> None:
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
                    kept = self.things.put(item, main, stations, side.sign * distance, 0.0, turn)
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
            stations = self.things.free_stations(main, side, rng.uniform(2.0, 100.0, count), 1.0)
            turn = 0.0 if side.sign > 0 else np.pi
            for station in stations:
                item = common[int(rng.integers(len(common)))]
                distance = side.sign * (side.edge + 0.65)
                self.things.put(item, main, np.array([station]), distance, side.level, turn)
        is_wide = self._layout.kind in (StreetKind.AVENUE, StreetKind.COUNTRY)
        if is_wide and rng.random() < 0.35:
            side = main.right
            if side.plots is not Plots.BLOCKS:
                spot = self.things.free_stations(main, side, rng.uniform(20.0, 80.0, 1), 3.0)
                distance = -(side.edge + 2.2)
                self.things.put(Item.DIRECTION_SIGN, main, spot, distance, side.level, np.pi)
        for side in main.sides:
            if side.setback > 3.5 and rng.random() < 0.12:
                spot = self.things.free_stations(main, side, rng.uniform(15.0, 80.0, 1), 3.0)
                distance = side.sign * (side.outer + 2.4)
                turn = np.pi + side.sign * float(rng.uniform(0.1, 0.7))
                self.things.put(Item.BILLBOARD, main, spot, distance, side.level, turn)

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
                    self.things.put(Item.TRAFFIC_LIGHT, road, spot, distance, side.level, turn)
                elif road is junction.cross:
                    item = Item.YIELD_SIGN if self._rng.random() < 0.75 else Item.STOP_SIGN
                    self.things.put(item, road, spot, distance, side.level, turn)
                if layout.kind is not StreetKind.COUNTRY:
                    corner = side.sign * (side.edge + 1.2)
                    ahead = np.array([station + direction * 1.5])
                    self.things.put(Item.NAME_SIGN, road, ahead, corner, side.level, np.pi / 2)

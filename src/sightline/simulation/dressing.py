"""Sets out what stands along a street: rows of trees, lamps, signs, lights, bollards, rails."""

from typing import Final

import numpy as np
from jaxtyping import Float, Float64

from sightline.simulation.layout import Ground, Layout, Plots, Road, Side, StreetKind
from sightline.simulation.materials import Material
from sightline.simulation.meshes.batches import QuadBatch, stamped
from sightline.simulation.meshes.furniture import Item, add_boxes_along, add_posts, item_model
from sightline.simulation.meshes.markings import stop_lines
from sightline.simulation.meshes.plots import ground_places
from sightline.simulation.meshes.primitives import Finish
from sightline.simulation.meshes.trees import Plants, Species, set_out
from sightline.simulation.scene import Mesh

_KERB_CLEARANCE: Final = 0.55
_FAR: Final = 115.0
_ROOM_M: Final = 1.1
"""Between things along a street."""
_ROW_TREES: Final = (Species.PLANE, Species.LIME, Species.CHERRY, Species.BIRCH, Species.POPLAR)


def dress(rng: np.random.Generator, layout: Layout) -> list[Mesh]:
    """All furniture and rows of trees of a street."""
    dresser = _Dresser(rng, layout)
    if layout.junction is not None:  # lights and signs of priority come before all else
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
    return dresser.meshes()


class _Dresser:
    """Collects places of things and makes their meshes at the end."""

    def __init__(self, rng: np.random.Generator, layout: Layout) -> None:
        self._rng = rng
        self._layout = layout
        self._places: dict[Item, list[np.ndarray]] = {}
        self._parts: list[Mesh] = []
        self._batch = QuadBatch()
        self._lamp = Item.POST_LAMP if rng.random() < 0.35 else Item.ARM_LAMP
        self._tree = _ROW_TREES[int(rng.integers(len(_ROW_TREES)))]

    def meshes(self) -> list[Mesh]:
        """Everything set out so far."""
        copies = []
        for item, rows in self._places.items():
            table = np.concatenate(rows)
            copies.append(stamped(item_model(item), table[:, :3], table[:, 3]))
        return [*self._parts, *copies, self._batch.mesh()]

    def put(
        self,
        item: Item,
        road: Road,
        stations: Float[np.ndarray, " count"],
        offset: float,
        level: float,
        turn: float,
    ) -> None:
        """Sets things at stations of a road, turned against its heading by `turn`.

        Those that would stand in something set out before are left out.
        """
        if len(stations) == 0:
            return
        places = ground_places(self._layout, road, stations, offset, level)
        earlier = [row[:, :2] for found in self._places.values() for row in found]
        if earlier:
            apart = np.linalg.norm(places[:, None, :2] - np.concatenate(earlier)[None], axis=-1)
            free = apart.min(axis=1) > _ROOM_M
            stations, places = stations[free], places[free]
        yaws = road.line.yaw(stations) + turn
        rows = np.concatenate((places, yaws[:, None]), axis=1)
        self._places.setdefault(item, []).append(rows)

    def free_stations(
        self, road: Road, side: Side, stations: Float[np.ndarray, " count"], margin: float
    ) -> Float64[np.ndarray, " num_free"]:
        """The stations outside the junction."""
        free = np.ones(len(stations), dtype=bool)
        for start, stop in side.gaps:
            free &= (stations < start - margin) | (stations > stop + margin)
        inside = (stations > road.first + 1.0) & (stations < min(road.last, _FAR) - 1.0)
        kept: Float64[np.ndarray, " num_free"] = stations[free & inside]
        return kept

    def trees(self, road: Road, side: Side) -> None:
        """A row of equal trees on the verge or at the pavement's edge."""
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
        pitch = float(rng.uniform(7.0, 14.0))
        first = road.first + float(rng.uniform(0, pitch))
        stations = self.free_stations(road, side, np.arange(first, road.last, pitch), 1.0)
        stations = stations[rng.random(len(stations)) < 0.9]
        stations = stations + rng.uniform(-0.6, 0.6, len(stations))
        places = ground_places(self._layout, road, stations, side.sign * distance, side.level)
        usual = {Species.CHERRY: 5.0, Species.BIRCH: 9.0, Species.POPLAR: 14.0}.get(self._tree, 9.5)
        heights = usual * rng.uniform(0.8, 1.15) * rng.uniform(0.88, 1.1, len(stations))
        self._parts += set_out(rng, self._tree, Plants(places=places, heights=heights, spread=1.0))

    def lamps(self, road: Road, side: Side) -> None:
        """Lamps along the kerb, on both sides or one."""
        rng = self._rng
        one_sided = self._layout.kind is StreetKind.RESIDENTIAL
        if one_sided and side.sign > 0 and rng.random() < 0.7:
            return
        pitch = 22.0 if self._lamp is Item.POST_LAMP else 31.0
        first = road.first + float(rng.uniform(0, pitch))
        stations = self.free_stations(road, side, np.arange(first, road.last, pitch), 0.5)
        distance = side.edge + _KERB_CLEARANCE
        turn = -side.sign * np.pi / 2
        self.put(self._lamp, road, stations, side.sign * distance, side.level, turn)

    def small_things(self, road: Road, side: Side) -> None:
        """Bollards, bins, cabinets and the like at the kerb or against the plots."""
        rng = self._rng
        inner, outer = side.edge + 0.45, side.outer - 0.3
        facing = -side.sign * np.pi / 2
        at_kerb = (
            (Item.BOLLARD, 0.15), (Item.BIN, 0.35), (Item.PARKING_SIGN, 0.35),
            (Item.NO_PARKING_SIGN, 0.3), (Item.BICYCLE_STAND, 0.15),
        )  # fmt: skip
        at_plots: tuple[tuple[Item, float], ...] = (
            (Item.CABINET, 0.5), (Item.LETTER_BOX, 0.15), (Item.WHEELED_BIN, 0.45),
            (Item.BENCH, 0.15), (Item.SHELTER, 0.08), (Item.ADVERT_COLUMN, 0.06),
        )  # fmt: skip
        if self._layout.kind in (StreetKind.CITY, StreetKind.SQUARE):
            at_plots = (*at_plots, (Item.PLANTER, 0.5))
        for things, distance in ((at_kerb, inner), (at_plots, outer)):
            for item, chance in things:
                if rng.random() >= chance:
                    continue
                count = int(rng.integers(1, 4))
                stations = rng.uniform(-10.0, 70.0, count)
                if item is Item.BOLLARD:
                    stations = stations[0] + 1.6 * np.arange(int(rng.integers(4, 14)))
                elif item is Item.WHEELED_BIN:
                    stations = (stations[:, None] + 0.65 * np.arange(3)).ravel()
                is_sign = item in (Item.PARKING_SIGN, Item.NO_PARKING_SIGN)
                turn = (0.0 if side.sign > 0 else np.pi) if is_sign else facing
                reach = distance - (0.6 if item in (Item.SHELTER, Item.ADVERT_COLUMN) else 0.0)
                free = self.free_stations(road, side, stations, 1.0)
                self.put(item, road, free, side.sign * reach, side.level, turn)

    def country_side(self, road: Road, side: Side) -> None:
        """Delineators, and now and then a guard rail or a line of poles."""
        rng = self._rng
        distance = side.edge + 0.6
        stations = np.arange(road.first + 6.0, road.last, 25.0 if rng.random() < 0.5 else 50.0)
        free = self.free_stations(road, side, stations, 2.0)
        self.put(Item.DELINEATOR, road, free, side.sign * distance, side.level, 0.0)
        if rng.random() < 0.3 and road is self._layout.main:
            for start, stop in side.stretches(max(road.first, -40.0), road.last, 6.0):
                self._guard_rail(road, side, np.arange(start, stop, 4.0))
        if rng.random() < 0.25:
            poles = self.free_stations(road, side, np.arange(road.first, road.last, 38.0), 3.0)
            far = side.sign * (side.outer + 3.5)
            self.put(Item.WIRE_POLE, road, poles, far, -0.1, 0.0)

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
        """Benches, trees in planters and bollards on a pedestrian zone."""
        rng, main = self._rng, self._layout.main
        for side in main.sides:
            width = side.outer - side.edge
            for item, chance in ((Item.BENCH, 0.7), (Item.PLANTER, 0.6), (Item.BICYCLE_STAND, 0.4)):
                if rng.random() < chance and width > 4.0:
                    stations = np.arange(rng.uniform(-5, 8), 70.0, rng.uniform(9.0, 18.0))
                    turn = -side.sign * np.pi / 2
                    distance = side.edge + 0.6
                    self.put(item, main, stations, side.sign * distance, 0.0, turn)

    def signs(self) -> None:
        """Signs beside the main road."""
        rng, main = self._rng, self._layout.main
        if self._layout.kind is StreetKind.SQUARE:
            return
        common = (Item.SPEED_SIGN, Item.PRIORITY_SIGN, Item.NO_PARKING_SIGN, Item.PATH_SIGN)
        for side in main.sides:
            count = int(rng.integers(1, 4))
            stations = self.free_stations(main, side, rng.uniform(2.0, 100.0, count), 1.0)
            turn = 0.0 if side.sign > 0 else np.pi
            for station in stations:
                item = common[int(rng.integers(len(common)))]
                distance = side.sign * (side.edge + 0.65)
                self.put(item, main, np.array([station]), distance, side.level, turn)
        is_wide = self._layout.kind in (StreetKind.AVENUE, StreetKind.COUNTRY)
        if is_wide and rng.random() < 0.35:
            side = main.right
            if side.plots is not Plots.BLOCKS:
                spot = self.free_stations(main, side, rng.uniform(20.0, 80.0, 1), 3.0)
                distance = -(side.edge + 2.2)
                self.put(Item.DIRECTION_SIGN, main, spot, distance, side.level, np.pi)

    def junction(self) -> None:
        """Lights or signs of priority at each stop line, and a street's name at a corner."""
        layout, junction = self._layout, self._layout.junction
        assert junction is not None, "called for streets with a junction only"
        for road in layout.roads:
            for station, direction in stop_lines(layout, road):
                side = road.right if direction > 0 else road.left
                turn = np.pi if direction > 0 else 0.0
                distance = side.sign * (side.edge + 0.5)
                spot = np.array([station])
                if junction.has_lights:
                    self.put(Item.TRAFFIC_LIGHT, road, spot, distance, side.level, turn)
                elif road is junction.cross:
                    item = Item.YIELD_SIGN if self._rng.random() < 0.75 else Item.STOP_SIGN
                    self.put(item, road, spot, distance, side.level, turn)
                if layout.kind is not StreetKind.COUNTRY:
                    corner = side.sign * (side.edge + 1.2)
                    ahead = np.array([station + direction * 1.5])
                    self.put(Item.NAME_SIGN, road, ahead, corner, side.level, np.pi / 2)

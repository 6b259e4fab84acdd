"""Free ground of a street, and objects placed on it."""

from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Float64

from sightline.simulation.arrays import AnyValues, Points, Values
from sightline.simulation.scene import Material, Mesh
from sightline.simulation.shapes.edits import stamped
from sightline.simulation.streets.ground import surface_height
from sightline.simulation.streets.layout import Layout, Road, Side, ground_places
from sightline.simulation.surroundings.furniture import Item, item_footprint, item_model
from sightline.simulation.surroundings.trees import Plants, Species, set_out


class Occupancy:
    """Occupied ground at each of a few moments: rotated rectangles viewed from above."""

    def __init__(self, num_moments: int) -> None:
        self._boxes = np.zeros((0, num_moments, 5))

    @property
    def num_moments(self) -> int:
        """Number of moments with stored occupancy."""
        return self._boxes.shape[1]

    def try_add(
        self,
        poses: Float[np.ndarray, "num_moments fields"],
        length: float,
        width: float,
        margin: float = 0.0,
    ) -> bool:
        """Occupy a rectangle's ground at its poses if `is_free`; return whether it was free."""
        free = self.is_free(poses, length, width, margin)
        if free:
            self.take(poses, length, width)
        return free

    def is_free(
        self,
        poses: Float[np.ndarray, "num_moments fields"],
        length: float,
        width: float,
        margin: float = 0.0,
    ) -> bool:
        """Test whether the ground of a rectangle is free at all its poses (x, y, z, yaw, others).

        Its length is along its heading; all others are `margin` [m] away, which is not kept free
        later.
        """
        sizes = np.tile([length, width], (len(poses), 1))
        candidate = np.concatenate((poses[:, [0, 1, 3]], sizes), axis=1)
        grown = candidate + np.array([0.0, 0.0, 0.0, 2 * margin, 2 * margin])
        reach = np.hypot(self._boxes[..., 3], self._boxes[..., 4]) + np.hypot(*grown[0, 3:])
        apart = np.hypot(*np.moveaxis(self._boxes[..., :2] - grown[:, :2], -1, 0))
        near = apart < reach / 2
        if near.any():
            rows, moments = np.nonzero(near)
            return not rectangles_overlap(self._boxes[rows, moments], grown[moments]).any()
        return True

    def take(
        self, poses: Float[np.ndarray, "num_moments fields"], length: float, width: float
    ) -> None:
        """Occupy the ground of a rectangle at its poses, even if it is not free."""
        sizes = np.tile([length, width], (len(poses), 1))
        box = np.concatenate((poses[:, [0, 1, 3]], sizes), axis=1)
        self._boxes = np.concatenate((self._boxes, box[None]))


def rectangles_overlap(
    first: Float64[np.ndarray, "count 5"], second: Float64[np.ndarray, "count 5"]
) -> Bool[np.ndarray, " count"]:
    """Test pairs of rectangles (x, y, yaw, length, width) for overlap: no axis separates them."""
    between = second[:, :2] - first[:, :2]
    overlap = np.ones(len(first), dtype=bool)
    for box in (first, second):
        for quarter in (0.0, np.pi / 2):
            angle = box[:, 2] + quarter
            axis = np.stack((np.cos(angle), np.sin(angle)), axis=1)
            reach = _half_extent(first, angle) + _half_extent(second, angle)
            overlap &= np.abs((between * axis).sum(axis=1)) < reach
    return overlap


def _half_extent(boxes: Float64[np.ndarray, "count 5"], angle: Values) -> Values:
    turn = boxes[:, 2] - angle
    return np.asarray((np.abs(np.cos(turn)) * boxes[:, 3] + np.abs(np.sin(turn)) * boxes[:, 4]) / 2)


_FAR: Final = 115.0  # station beyond which nothing is placed [m]
_ROOM_M: Final = 0.25  # free space around objects along a street
_TINTS: Final = ((0.3, 0.3, 0.3), (1.7, 1.7, 1.7))  # range of the colour factors of painted objects

Rows = Float64[np.ndarray, "count 4"]  # x, y, z, yaw of objects


class StreetObjects:
    """Collector of object places in a street that makes their meshes at the end."""

    def __init__(self, rng: np.random.Generator, layout: Layout, taken: Occupancy) -> None:
        self._rng = rng
        self._layout = layout
        self._taken = taken
        self._places: dict[Item, list[np.ndarray]] = {}
        self._scales: dict[Item, list[np.ndarray]] = {}
        self._plants: list[Mesh] = []

    def meshes(self) -> list[Mesh]:
        """Make the meshes of everything placed so far."""
        copies = []
        for item, rows in self._places.items():
            table, scales = np.concatenate(rows), np.concatenate(self._scales[item])
            tints = self._rng.uniform(*_TINTS, (len(table), 3))
            copies.append(
                stamped(
                    item_model(item),
                    table[:, :3],
                    table[:, 3],
                    scales=scales,
                    tints=tints,
                    tinted=(Material.CAR_PAINT,),
                )
            )
        return [*self._plants, *copies]

    def put(
        self,
        item: Item,
        road: Road,
        stations: AnyValues,
        offset: float,
        level: float | None,
        turn: float,
        *,
        scale: tuple[float, float, float] = (1.0, 1.0, 1.0),
    ) -> Float64[np.ndarray, " num_set"]:
        """Place objects at stations of a road, turned against its heading by `turn`.

        Objects that would overlap an earlier object, a road user or a house are left out. Objects
        stand `level` above the terrain; if it is None, they stand on the surface with its crown and
        kerbs. Returns the stations of the placed objects.
        """
        if level is None:
            places = self.on_surface(road, stations, offset)
        else:
            places = ground_places(self._layout, road, stations, offset, level)
        rows = np.concatenate((places, (road.line.yaw(stations) + turn)[:, None]), axis=1)
        length, width = item_footprint(item)
        free = self.settle(rows, length * scale[0], width * scale[1])
        self.add(item, rows[free], scale)
        return np.asarray(stations[free])

    def on_surface(self, road: Road, stations: AnyValues, offset: float) -> Points:
        """Compute world points on the surface of a road or beside it, including crown and kerbs."""
        offsets = np.full(len(stations), offset)
        heights = surface_height(self._layout.terrain, road, stations, offsets)
        return np.concatenate((road.line.place(stations, offsets), heights[:, None]), axis=1)

    def add(
        self, item: Item, rows: Rows, scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    ) -> None:
        """Add objects at x, y, z, yaw, without a check for free ground."""
        self._places.setdefault(item, []).append(rows)
        self._scales.setdefault(item, []).append(np.tile(scale, (len(rows), 1)))

    def plant(self, species: Species, plants: Plants) -> None:
        """Add plants at their places, without a check for free ground."""
        self._plants += set_out(self._rng, species, plants)

    def settle(self, rows: Rows, length: float, width: float) -> Bool[np.ndarray, " count"]:
        """Occupy free ground of objects at x, y, z, yaw; return a mask of the placed ones."""
        still = [np.tile(row, (self._taken.num_moments, 1)) for row in rows]
        free = [self._taken.is_free(poses, length, width, _ROOM_M) for poses in still]
        for poses, is_free in zip(still, free, strict=True):
            if is_free:
                self._taken.take(poses, length, width)
        return np.array(free, dtype=bool)

    def free_stations(
        self, road: Road, side: Side, stations: AnyValues, margin: float
    ) -> Float64[np.ndarray, " num_free"]:
        """Select stations on the road, `margin` [m] from the junction and not too far ahead."""
        free = np.ones(len(stations), dtype=bool)
        for start, stop in side.gaps:
            free &= (stations < start - margin) | (stations > stop + margin)
        inside = (stations > road.first + 1.0) & (stations < min(road.last, _FAR) - 1.0)
        return np.asarray(stations[free & inside])

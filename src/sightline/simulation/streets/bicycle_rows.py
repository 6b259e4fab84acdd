"""Rows of parked bicycles: in stands, along walls and at the kerb. None has a rider or a label."""

from functools import cache
from typing import Final, NamedTuple

import numpy as np

from sightline.simulation.bodies.cyclists import make_parked_bicycle
from sightline.simulation.scene import Material, Mesh
from sightline.simulation.shapes.edits import stamped
from sightline.simulation.shapes.primitives import Finish, tube
from sightline.simulation.streets.free_ground import Rows, StreetObjects
from sightline.simulation.streets.layout import Layout, Road, Side, StreetKind, ground_places

_DESIGNS: Final = 6
_LENGTH_M: Final = 1.8
_PITCHES_M: Final = (0.38, 0.8)
_MOST: Final = 24  # in one row
_LIMIT: Final = 90  # in a street
_TINTS: Final = ((0.4, 0.4, 0.4), (2.2, 2.2, 2.2))
_HOOP: Final = Finish(Material.METAL, (0.36, 0.37, 0.38))
_FIRST_M, _LAST_M = 3.0, 55.0


class _Row(NamedTuple):
    """Places of the bicycles of one row and of the hoops between them: x, y, z, yaw."""

    bicycles: Rows
    hoops: Rows


def park_bicycles(
    rng: np.random.Generator, layout: Layout, objects: StreetObjects, mean_rows: float
) -> list[Mesh]:
    """Place rows of bicycles where the pavement has room and build their meshes.

    `mean_rows` is the mean number of rows on each side of a road. They extend the ground that
    `objects` have taken. Country roads have none.
    """
    if layout.kind is StreetKind.COUNTRY:
        return []
    rows: list[_Row] = []
    for road in layout.roads:
        for side in road.sides:
            for _ in range(int(rng.poisson(mean_rows))):
                if sum(len(row.bicycles) for row in rows) < _LIMIT:
                    row = _draw_row(rng, layout, objects, road, side)
                    rows += [] if row is None else [row]
    if not rows:
        return []
    bicycles = np.concatenate([row.bicycles for row in rows])
    hoops = np.concatenate([row.hoops for row in rows])
    design = rng.integers(0, _DESIGNS, len(bicycles))
    tints = rng.uniform(*_TINTS, (len(bicycles), 3))
    meshes = [stamped(_hoop(), hoops[:, :3], hoops[:, 3])]
    for kind in range(_DESIGNS):
        own = design == kind
        meshes.append(
            stamped(
                _bicycle(kind),
                bicycles[own, :3],
                bicycles[own, 3],
                tints=tints[own],
                tinted=(Material.CAR_PAINT,),
            )
        )
    return meshes


def _draw_row(
    rng: np.random.Generator, layout: Layout, objects: StreetObjects, road: Road, side: Side
) -> _Row | None:
    """Draw a row at the kerb or at the plots, across the pavement or along it; None: no room."""
    room = side.outer - side.edge
    across = room > _LENGTH_M + 0.9
    pitch = float(rng.uniform(*_PITCHES_M)) if across else float(rng.uniform(1.6, 2.2))
    count = int(rng.integers(4, _MOST if across else 7))
    lean = float(rng.uniform(-0.6, 0.6)) if across and rng.random() < 0.4 else 0.0
    deep = _LENGTH_M * np.cos(lean) if across else 0.5
    at_kerb = rng.random() < 0.5
    distance = side.edge + 0.35 + deep / 2 if at_kerb else side.outer - 0.1 - deep / 2
    first = float(rng.uniform(_FIRST_M, _LAST_M))
    if road is not layout.main:
        first -= (_FIRST_M + _LAST_M) / 2 + count * pitch / 2
    stations = first + pitch * np.arange(count)
    if len(objects.free_stations(road, side, stations, 1.5)) < count:
        return None
    middle = ground_places(layout, road, stations.mean(keepdims=True), side.sign * distance, 0.0)
    yaw = road.line.yaw(stations.mean(keepdims=True))
    ground = np.concatenate((middle, yaw[:, None]), axis=1)
    if not objects.settle(ground, count * pitch + 1.0, deep).all():
        return None
    taken = rng.random(count) < rng.uniform(0.55, 1.0)
    at = stations[taken] + rng.normal(0, 0.04, taken.sum())
    offsets = side.sign * (distance + rng.normal(0, 0.06, len(at)))
    places = ground_places(layout, road, at, offsets, side.level)
    turns = (np.pi / 2 + lean if across else 0.0) + rng.normal(0, 0.06, len(at))
    turns = turns + np.pi * (rng.random(len(at)) < rng.uniform(0, 0.5))
    bicycles = np.concatenate((places, (road.line.yaw(at) + turns)[:, None]), axis=1)
    between = stations[::2] - pitch / 2 if across and rng.random() < 0.7 else stations[:0]
    posts = ground_places(layout, road, between, side.sign * distance, side.level)
    facing = road.line.yaw(between) + np.pi / 2 + lean
    return _Row(bicycles, np.concatenate((posts, facing[:, None]), axis=1))


@cache
def _bicycle(design: int) -> Mesh:
    """Build one of the designs; all streets share them."""
    return make_parked_bicycle(np.random.default_rng([7, design]))


@cache
def _hoop() -> Mesh:
    path = [(-0.4, 0, -0.1), (-0.4, 0, 0.7), (-0.3, 0, 0.8), (0.3, 0, 0.8), (0.4, 0, 0.7),
            (0.4, 0, -0.1)]  # fmt: skip
    return tube(path, 0.024, _HOOP, num_sides=6, capped=False)

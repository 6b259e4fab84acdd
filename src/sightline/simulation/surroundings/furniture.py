"""Street furniture: lamps, signs, lights, bollards, bins, benches, fences, rails."""

from collections.abc import Callable, Mapping
from enum import Enum
from functools import cache
from typing import Final

import numpy as np
from jaxtyping import Float

from sightline.simulation.scene import Material, Mesh
from sightline.simulation.shapes.edits import QuadBatch, box_corners
from sightline.simulation.shapes.primitives import (
    Finish,
    box,
    disc,
    moved,
    polygon,
    quads,
    superellipsoid,
    tube,
)
from sightline.simulation.surroundings.clutter import CLUTTER

_PAINT: Final = Finish(Material.CAR_PAINT, (0.30, 0.28, 0.26))
_STEEL: Final = Finish(Material.METAL, (0.38, 0.39, 0.40))
_BLACK: Final = Finish(Material.PLASTIC, (0.02, 0.02, 0.02))
_AMBER: Final = Finish(Material.PLASTIC, (0.80, 0.40, 0.01))
_BEACON_RED: Final = Finish(Material.RETRO_REFLECTOR, (0.55, 0.04, 0.03))
_WHITE: Final = Finish(Material.RETRO_REFLECTOR, (0.80, 0.80, 0.78))
_BLUE: Final = Finish(Material.RETRO_REFLECTOR, (0.02, 0.08, 0.36))
_BARK: Final = Finish(Material.BARK, (0.20, 0.15, 0.11))
_WOOD: Final = Finish(Material.WOOD, (0.30, 0.22, 0.14))
_GREEN: Final = Finish(Material.LEAF, (0.08, 0.15, 0.04))
_SAND: Final = Finish(Material.SOIL, (0.30, 0.24, 0.16))
_GRIT: Final = Finish(Material.GRAVEL, (0.26, 0.25, 0.24))


def _mast(height: float, radius: float, finish: Finish = _STEEL) -> Mesh:
    return tube([(0, 0, -0.3), (0, 0, height)], radius, finish, num_sides=9)


def _beacon() -> list[Mesh]:
    """Build a striped panel on a foot, as used at road works."""
    stripes = [
        box((0, 0, 0.22 + 0.2 * row), (0.03, 0.125, 0.1), _WHITE if row % 2 else _BEACON_RED)
        for row in range(5)
    ]
    return [box((0, 0, 0.02), (0.2, 0.4, 0.1), _BLACK), *stripes]


def _lit_beacon() -> list[Mesh]:
    lamp = superellipsoid((0, 0, 1.28), (0.07, 0.1, 0.1), _AMBER, num_rings=6, num_sides=10)
    return [*_beacon(), box((0, 0, 1.15), (0.06, 0.09, 0.06), _AMBER), lamp]


def _chevrons() -> list[Mesh]:
    """Build a board of arrows at the height of a person's chest, on a post."""
    boards = [
        box((0.06, -0.2 + 0.1 * row, 0.95), (0.015, 0.05, 0.26), _BEACON_RED if row % 2 else _WHITE)
        for row in range(5)
    ]
    return [_mast(1.25, 0.04), *boards]


def _signal_mast() -> list[Mesh]:
    """Build a pedestrian light with a button."""
    return [
        _mast(3.3, 0.07),
        box((0.16, 0, 2.4), (0.1, 0.13, 0.36), _BLACK),
        box((0.12, 0.0, 1.55), (0.06, 0.08, 0.16), _BLACK),
        box((0.1, 0.03, 1.05), (0.05, 0.06, 0.11), _AMBER),
    ]


def _poster_pole() -> list[Mesh]:
    """Build a lamp pole with placards tied to both sides."""
    boards = [box((out, 0, 1.0), (0.012, 0.3, 0.43), _PAINT) for out in (-0.1, 0.1)]
    return [_mast(5.0, 0.075), *boards]


def _staked_tree() -> list[Mesh]:
    """Build a young tree between three stakes."""
    turns = np.arange(3) * 2 * np.pi / 3
    feet = [(0.33 * float(np.cos(turn)), 0.33 * float(np.sin(turn)), 0.0) for turn in turns]
    rail = [*feet, feet[0]]
    return [
        *(moved(tube([(0, 0, -0.2), (0, 0, 1.6)], 0.04, _WOOD), foot) for foot in feet),
        tube([(x, y, 1.5) for x, y, _ in rail], 0.03, _WOOD, num_sides=5),
        _mast(3.2, 0.04, _BARK),
        superellipsoid((0, 0, 3.6), (0.9, 0.9, 1.0), _GREEN, num_rings=7),
    ]


DECOYS: Final[Mapping[str, Callable[[], list[Mesh]]]] = {
    "beacon": _beacon,
    "lit beacon": _lit_beacon,
    "keep-right sign": lambda: [
        _mast(0.9, 0.035), tube([(0.05, 0, 1.1), (0.08, 0, 1.1)], 0.3, _BLUE, num_sides=18)
    ],
    "chevrons": _chevrons,
    "signal mast": _signal_mast,
    "poster pole": _poster_pole,
    "display stand": lambda: [
        box((0, 0, 0.0), (0.28, 0.3, 0.16), _BLACK),
        superellipsoid((0, 0, 0.75), (0.05, 0.32, 0.58), _PAINT, exponents=(0.4, 0.4)),
    ],
    "litter bin": lambda: [
        _mast(0.9, 0.23, _PAINT), superellipsoid((0, 0, 0.92), (0.25, 0.25, 0.12), _BLACK)
    ],
    "parking meter": lambda: [_mast(1.1, 0.06), box((0, 0, 1.4), (0.11, 0.15, 0.32), _PAINT)],
    "bare trunk": lambda: [
        tube([(0, 0, -0.2), (0, 0, 0.3), (0.05, 0.03, 4.5)], (0.34, 0.25, 0.18), _BARK)
    ],
    "leaning trunks": lambda: [
        tube([(0, 0.12, -0.2), (0.1, 0.3, 1.6), (0.3, 0.9, 4.5)], (0.22, 0.16, 0.1), _BARK),
        tube([(0, -0.1, -0.2), (-0.05, -0.25, 1.6), (-0.3, -0.7, 4.0)], (0.2, 0.14, 0.1), _BARK),
    ],
    "staked tree": _staked_tree,
    "sand heap": lambda: [
        tube([(0, 0, -0.1), (0, 0, 0.8), (0, 0, 1.25)], (2.0, 0.7, 0.1), _SAND, num_sides=18)
    ],
    "gravel heap": lambda: [
        tube([(0, 0, -0.1), (0, 0, 0.6), (0, 0, 0.95)], (1.9, 1.2, 0.4), _GRIT, num_sides=18)
    ],
    "stack of pallets": lambda: [
        box((0, 0, 0.6), (0.34, 0.54, 0.75), _WOOD),
        *(box((0, 0, 0.07 + 0.15 * row), (0.4, 0.6, 0.06), _WOOD) for row in range(9)),
    ],
    "container": lambda: [
        box((0, 0, 0.6), (1.1, 2.2, 0.8), _PAINT), box((0, 0, 1.42), (1.15, 2.25, 0.04), _STEEL)
    ],
}  # fmt: skip
"""Parts of each object; its foot is at the origin, its face looks along x."""


_SIGN_BACK: Final = Finish(Material.METAL, (0.42, 0.43, 0.44))
_RED: Final = Finish(Material.RETRO_REFLECTOR, (0.55, 0.03, 0.03))
_YELLOW: Final = Finish(Material.RETRO_REFLECTOR, (0.75, 0.52, 0.02))
_HEAD_M: Final = 1.9


class Item(Enum):
    """Items copied along a street; their face or front looks along x."""

    ARM_LAMP = "arm lamp"
    POST_LAMP = "post lamp"
    SPEED_SIGN = "speed sign"
    YIELD_SIGN = "yield sign"
    PRIORITY_SIGN = "priority sign"
    STOP_SIGN = "stop sign"
    PARKING_SIGN = "parking sign"
    NO_PARKING_SIGN = "no parking sign"
    PATH_SIGN = "path sign"
    NAME_SIGN = "name sign"
    DIRECTION_SIGN = "direction sign"
    TRAFFIC_LIGHT = "traffic light"
    BOLLARD = "bollard"
    DELINEATOR = "delineator"
    BIN = "bin"
    WHEELED_BIN = "wheeled bin"
    BENCH = "bench"
    CABINET = "cabinet"
    LETTER_BOX = "letter box"
    ADVERT_COLUMN = "advert column"
    SHELTER = "shelter"
    BICYCLE_STAND = "bicycle stand"
    PLANTER = "planter"
    WIRE_POLE = "wire pole"
    BICYCLE = "bicycle"
    HYDRANT = "hydrant"
    PILLAR = "pillar"
    GRIT_BOX = "grit box"
    POSTER = "poster"
    BILLBOARD = "billboard"
    SANDWICH_BOARD = "sandwich board"
    BOTTLE_BANK = "bottle bank"
    PARASOL = "parasol"
    CONE = "cone"
    BARRIER = "barrier"
    SKIP = "skip"
    SITE_CABIN = "site cabin"
    SCAFFOLD = "scaffold"
    BEACON = "beacon"
    LIT_BEACON = "lit beacon"
    KEEP_RIGHT_SIGN = "keep-right sign"
    CHEVRONS = "chevrons"
    SIGNAL_MAST = "signal mast"
    POSTER_POLE = "poster pole"
    DISPLAY_STAND = "display stand"
    LITTER_BIN = "litter bin"
    PARKING_METER = "parking meter"
    BARE_TRUNK = "bare trunk"
    LEANING_TRUNKS = "leaning trunks"
    STAKED_TREE = "staked tree"
    SAND_HEAP = "sand heap"
    GRAVEL_HEAP = "gravel heap"
    STACK_OF_PALLETS = "stack of pallets"
    CONTAINER = "container"


@cache
def item_model(item: Item) -> Mesh:
    """Build the mesh of an item, with its foot at the origin; cached."""
    for plain in (CLUTTER, DECOYS):
        if item.value in plain:
            return Mesh.joined(plain[item.value]())
    return _MAKERS[item]()


@cache
def item_footprint(item: Item) -> tuple[float, float]:
    """Compute length and width [m] of an item's ground area, up to a person's height."""
    vertices = item_model(item).vertices
    reach = 2 * np.abs(vertices[vertices[:, 2] < _HEAD_M, :2]).max(axis=0)
    return float(reach[0]), float(reach[1])


def _post(height: float, radius: float = 0.03, finish: Finish = _STEEL) -> Mesh:
    return tube([(0, 0, -0.3), (0, 0, height)], radius, finish, num_sides=7)


def _face(
    sides: int, radius: float, finish: Finish, out: float, height: float, turn: float
) -> Mesh:
    """Build a regular polygon that faces along x."""
    angles = turn + np.arange(sides) * 2 * np.pi / sides
    corners = np.stack(
        (np.full(sides, out), radius * np.cos(angles), height + radius * np.sin(angles)), axis=1
    )
    return polygon(corners, finish)


def _plate(
    half: tuple[float, float], finish: Finish, out: float, center: tuple[float, float]
) -> Mesh:
    """Build a rectangle facing along x, from its half width and height and its middle (y, z)."""
    (w, h), (y, z) = half, center
    corners = [[out, y - w, z - h], [out, y + w, z - h], [out, y + w, z + h], [out, y - w, z + h]]
    return quads(np.array([corners]), finish)


def _sign(sides: int, radius: float, rings: list[tuple[float, Finish]], turn: float) -> Mesh:
    """Build a sign of nested polygons, each a share of the whole, on a post."""
    height = 2.35
    back = _face(sides, radius, _SIGN_BACK, 0.03, height, turn)
    faces = [
        _face(sides, radius * share, finish, 0.036 + 0.004 * row, height, turn)
        for row, (share, finish) in enumerate(rings)
    ]
    return Mesh.joined((_post(height + 0.2), back, *faces))


def _speed_sign() -> Mesh:
    base = _sign(20, 0.30, [(1.0, _RED), (0.78, _WHITE)], 0.0)
    digits = []
    for left in (-0.12, 0.02):
        digits += [_plate((0.012, 0.09), _BLACK, 0.048, (left + dy, 2.35)) for dy in (0.0, 0.09)]
        digits += [
            _plate((0.05, 0.012), _BLACK, 0.048, (left + 0.045, 2.35 + dz)) for dz in (-0.08, 0.08)
        ]
    return Mesh.joined((base, *digits))


def _no_parking_sign() -> Mesh:
    base = _sign(20, 0.26, [(1.0, _RED), (0.82, _BLUE)], 0.0)
    bar = np.array(
        [[0.05, -0.17, 2.49], [0.05, -0.14, 2.52], [0.05, 0.17, 2.21], [0.05, 0.14, 2.18]]
    )
    return Mesh.joined((base, polygon(bar[::-1], _RED)))


def _rectangular_sign(half: tuple[float, float], finish: Finish, mark: Mesh | None) -> Mesh:
    center = (0.0, 2.3)
    back = _plate(half, _SIGN_BACK, 0.03, center)
    rim = _plate(half, _WHITE, 0.036, center)
    face = _plate((half[0] - 0.015, half[1] - 0.015), finish, 0.040, center)
    parts = [_post(2.3 + half[1]), back, rim, face]
    return Mesh.joined(parts if mark is None else [*parts, mark])


def _name_sign() -> Mesh:
    text = [
        _plate((0.03, 0.035), _WHITE, 0.05, (-0.36 + 0.105 * row, 2.3))
        for row in range(8)
        if row != 4
    ]
    return _rectangular_sign((0.5, 0.11), _BLUE, Mesh.joined(text))


def _direction_sign() -> Mesh:
    posts = [moved(_post(3.4, 0.045), (0.0, y, 0.0)) for y in (-0.8, 0.8)]
    board = _plate((1.25, 0.75), _YELLOW, 0.06, (0.0, 2.6))
    back = _plate((1.25, 0.75), _SIGN_BACK, 0.05, (0.0, 2.6))
    lines = [_plate((0.7, 0.05), _BLACK, 0.066, (-0.2, 2.25 + 0.33 * row)) for row in range(3)]
    return Mesh.joined((*posts, board, back, *lines))


def _traffic_light() -> Mesh:
    pole = tube([(0, 0, -0.3), (0, 0, 3.4)], 0.06, _STEEL, num_sides=8)
    housing = box((0.16, 0, 2.75), (0.10, 0.15, 0.46), _BLACK)
    back = box((0.10, 0, 2.75), (0.01, 0.26, 0.60), _BLACK)
    rim = _plate((0.26, 0.60), _WHITE, 0.088, (0.0, 2.75))
    lamps = []
    for row, color in enumerate(((0.03, 0.25, 0.12), (0.25, 0.15, 0.01), (0.60, 0.02, 0.02))):
        height = 2.45 + 0.3 * row
        lens = Finish(Material.TAIL_LIGHT if row == 2 else Material.PLASTIC, color)
        lamps.append(disc((0.265, 0, height), (1, 0, 0), 0.10, lens, num_sides=12))
        lamps.append(box((0.33, 0, height + 0.12), (0.08, 0.11, 0.008), _BLACK))
    box_low = box((0.08, 0.05, 1.15), (0.06, 0.06, 0.12), _YELLOW)
    return Mesh.joined((pole, housing, back, rim, *lamps, box_low))


_MAKERS: Final = {
    Item.SPEED_SIGN: _speed_sign,
    Item.YIELD_SIGN: lambda: _sign(3, 0.50, [(1.0, _RED), (0.66, _WHITE)], -np.pi / 2),
    Item.PRIORITY_SIGN: lambda: _sign(4, 0.42, [(1.0, _WHITE), (0.66, _YELLOW)], 0.0),
    Item.STOP_SIGN: lambda: _sign(8, 0.42, [(1.0, _WHITE), (0.94, _RED)], np.pi / 8),
    Item.PARKING_SIGN: lambda: _rectangular_sign(
        (0.21, 0.21), _BLUE, _plate((0.03, 0.13), _WHITE, 0.05, (0.04, 2.3))
    ),
    Item.NO_PARKING_SIGN: _no_parking_sign,
    Item.PATH_SIGN: lambda: _sign(20, 0.26, [(1.0, _WHITE), (0.96, _BLUE)], 0.0),
    Item.NAME_SIGN: _name_sign,
    Item.DIRECTION_SIGN: _direction_sign,
    Item.TRAFFIC_LIGHT: _traffic_light,
}


def add_boxes_along(
    batch: QuadBatch,
    line: Float[np.ndarray, "num_points 3"],
    finish: Finish,
    *,
    half_width: float,
    heights: tuple[float, float],
) -> None:
    """Add a wall or rail along a line of world points, between two heights above it."""
    steps = np.diff(line, axis=0)
    lengths = np.hypot(steps[:, 0], steps[:, 1])
    low, high = heights
    # Pieces overlap a little; otherwise bends would have gaps.
    halves = np.stack(
        (lengths / 2 + half_width * 0.5, np.full(len(steps), half_width),
         np.full(len(steps), (high - low) / 2)),
        axis=1,
    )  # fmt: skip
    centers = (line[1:] + line[:-1]) / 2 + [0, 0, (high + low) / 2]
    batch.add(box_corners(centers, halves, np.arctan2(steps[:, 1], steps[:, 0])), finish)


def add_posts(
    batch: QuadBatch,
    places: Float[np.ndarray, "count 3"],
    yaws: Float[np.ndarray, " count"],
    half_size: tuple[float, float, float],
    finish: Finish,
) -> None:
    """Add upright posts or pickets with their feet at places on the ground."""
    halves = np.tile(half_size, (len(places), 1))
    batch.add(box_corners(places + np.array([0, 0, half_size[2]]), halves, yaws), finish)

"""Street furniture: lamps, signs, bins, benches, and objects mistaken for people or cars."""

from collections.abc import Callable
from enum import Enum
from functools import cache
from typing import Any, Final

import numpy as np

from sightline.simulation.scene import Material, Mesh
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
from sightline.simulation.tables import read_table

# Plain objects, each a list of parts (shape, finish, center or path, half size or radii, and
# further arguments) with its foot at the origin; `decoys` look like people or cars to a LiDAR.
# Faces of `Material.CAR_PAINT` have another colour in each copy.
_TABLES: Final = read_table(__file__, "furniture")
_FINISHES: Final = {
    name: Finish(Material[material], (red, green, blue))
    for name, (material, (red, green, blue)) in _TABLES["finishes"].items()
}
_PARTS: Final[dict[str, tuple[Any, ...]]] = _TABLES["street"] | _TABLES["decoys"]
_SHAPES: Final[dict[str, Callable[..., Mesh]]] = {
    "box": box,
    "tube": tube,
    "superellipsoid": superellipsoid,
}
_STEEL: Final = _FINISHES["steel"]
_SIGN_BACK: Final = Finish(Material.METAL, (0.42, 0.43, 0.44))
_WHITE: Final = _FINISHES["white reflector"]
_RED: Final = Finish(Material.RETRO_REFLECTOR, (0.55, 0.03, 0.03))
_BLUE: Final = _FINISHES["blue reflector"]
_YELLOW: Final = Finish(Material.RETRO_REFLECTOR, (0.75, 0.52, 0.02))
_BLACK: Final = _FINISHES["black"]
_HEAD_M: Final = 1.9

# Items copied along a street; their face or front looks along x.
Item = Enum(
    "Item",
    "ARM_LAMP POST_LAMP SPEED_SIGN YIELD_SIGN PRIORITY_SIGN STOP_SIGN PARKING_SIGN "
    "NO_PARKING_SIGN PATH_SIGN NAME_SIGN DIRECTION_SIGN TRAFFIC_LIGHT BOLLARD DELINEATOR BIN "
    "WHEELED_BIN BENCH CABINET LETTER_BOX ADVERT_COLUMN SHELTER BICYCLE_STAND PLANTER WIRE_POLE "
    "BICYCLE HYDRANT PILLAR GRIT_BOX POSTER BILLBOARD SANDWICH_BOARD BOTTLE_BANK PARASOL CONE "
    "BARRIER SKIP SITE_CABIN SCAFFOLD BEACON LIT_BEACON KEEP_RIGHT_SIGN CHEVRONS SIGNAL_MAST "
    "POSTER_POLE DISPLAY_STAND LITTER_BIN PARKING_METER BARE_TRUNK LEANING_TRUNKS STAKED_TREE "
    "SAND_HEAP GRAVEL_HEAP STACK_OF_PALLETS CONTAINER ",
)


@cache
def item_model(item: Item) -> Mesh:
    """Build the mesh of an item, with its foot at the origin; cached."""
    if item in _MAKERS:
        return _MAKERS[item]()
    parts = []
    for shape, finish, place, size, *further in _PARTS[item.name]:
        options = further[0] if further else {}
        parts.append(_SHAPES[shape](place, size, _FINISHES[finish], **options))
    return Mesh.joined(parts)


@cache
def item_footprint(item: Item) -> tuple[float, float]:
    """Compute length and width [m] of an item's ground area, up to a person's height."""
    vertices = item_model(item).vertices
    reach = 2 * np.abs(vertices[vertices[:, 2] < _HEAD_M, :2]).max(axis=0)
    return float(reach[0]), float(reach[1])


def _post(height: float, radius: float = 0.03) -> Mesh:
    return tube([(0, 0, -0.3), (0, 0, height)], radius, _STEEL, num_sides=7)


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


def _bicycle() -> Mesh:
    turns = np.linspace(0.0, 2 * np.pi, 13)
    parts = []
    for hub in (-0.52, 0.52):
        rim = np.stack((hub + 0.33 * np.cos(turns), 0 * turns, 0.34 + 0.33 * np.sin(turns)), axis=1)
        parts.append(tube(rim, 0.017, _BLACK, num_sides=3, capped=False))
    bars = (
        ((-0.52, 0, 0.34), (-0.18, 0, 0.78), (0.40, 0, 0.80), (0.52, 0, 0.34)),
        ((-0.52, 0, 0.34), (-0.05, 0, 0.30), (0.40, 0, 0.76)),
        ((-0.05, 0, 0.30), (-0.21, 0, 0.94)),
        ((0.40, 0, 0.78), (0.36, 0, 1.02)),
    )
    parts += [tube(bar, 0.02, _FINISHES["paint"], num_sides=4, capped=False) for bar in bars]
    handle = box((0.34, 0, 1.03), (0.03, 0.28, 0.015), _BLACK)
    saddle = box((-0.22, 0, 0.95), (0.13, 0.07, 0.03), _BLACK)
    return Mesh.joined((*parts, handle, saddle))


def _staked_tree() -> Mesh:
    """Build a young tree between three stakes."""
    turns = np.arange(3) * 2 * np.pi / 3
    feet = [(0.33 * float(np.cos(turn)), 0.33 * float(np.sin(turn)), 0.0) for turn in turns]
    rail = [*feet, feet[0]]
    wood = _FINISHES["light wood"]
    return Mesh.joined(
        [
            *(moved(tube([(0, 0, -0.2), (0, 0, 1.6)], 0.04, wood), foot) for foot in feet),
            tube([(x, y, 1.5) for x, y, _ in rail], 0.03, wood, num_sides=5),
            tube([(0, 0, -0.3), (0, 0, 3.2)], 0.04, _FINISHES["bark"], num_sides=9),
            superellipsoid((0, 0, 3.6), (0.9, 0.9, 1.0), _FINISHES["light green"], num_rings=7),
        ]
    )


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
    Item.BICYCLE: _bicycle,
    Item.STAKED_TREE: _staked_tree,
}

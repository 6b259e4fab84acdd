"""What stands in streets: lamps, signs, lights, bollards, bins, benches, fences, rails."""

from enum import Enum
from functools import cache
from typing import Final

import numpy as np
from jaxtyping import Float

from sightline.simulation.materials import Material
from sightline.simulation.meshes.batches import QuadBatch, box_corners
from sightline.simulation.meshes.primitives import (
    Finish,
    box,
    disc,
    moved,
    polygon,
    quads,
    superellipsoid,
    tube,
)
from sightline.simulation.scene import Mesh

_STEEL: Final = Finish(Material.METAL, (0.38, 0.39, 0.40))
_DARK_STEEL: Final = Finish(Material.METAL, (0.08, 0.09, 0.09))
_WHITE: Final = Finish(Material.RETRO_REFLECTOR, (0.80, 0.80, 0.78))
_RED: Final = Finish(Material.RETRO_REFLECTOR, (0.55, 0.03, 0.03))
_BLUE: Final = Finish(Material.RETRO_REFLECTOR, (0.02, 0.08, 0.36))
_YELLOW: Final = Finish(Material.RETRO_REFLECTOR, (0.75, 0.52, 0.02))
_BLACK: Final = Finish(Material.PLASTIC, (0.02, 0.02, 0.02))
_LAMP: Final = Finish(Material.HEADLIGHT, (0.75, 0.74, 0.70))


class Item(Enum):
    """Things that are copied along a street; x is where their face looks, or their front."""

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


@cache
def item_model(item: Item) -> Mesh:
    """The mesh of a thing, its foot at the origin; made once."""
    return _MAKERS[item]()


def _post(height: float, radius: float = 0.03, finish: Finish = _STEEL) -> Mesh:
    return tube([(0, 0, -0.3), (0, 0, height)], radius, finish, num_sides=7)


def _arm_lamp() -> Mesh:
    path = [(0, 0, -0.3), (0, 0, 5.2), (0.12, 0, 6.6), (0.6, 0, 7.15), (1.7, 0, 7.35)]
    arm = tube(path, (0.10, 0.075, 0.055, 0.05, 0.045), _STEEL, num_sides=8)
    head = superellipsoid(
        (2.0, 0, 7.36),
        (0.42, 0.15, 0.09),
        _DARK_STEEL,
        exponents=(0.6, 0.6),
        num_rings=5,
        num_sides=10,
    )
    glass = polygon(
        np.array(
            [[1.65, 0.11, 7.28], [2.35, 0.11, 7.28], [2.35, -0.11, 7.28], [1.65, -0.11, 7.28]]
        ),
        _LAMP,
    )
    foot = tube([(0, 0, -0.1), (0, 0, 1.0)], 0.12, _STEEL, num_sides=8)
    return Mesh.joined((arm, head, glass, foot))


def _post_lamp() -> Mesh:
    pole = tube([(0, 0, -0.3), (0, 0, 3.6)], (0.065, 0.045), _DARK_STEEL, num_sides=8)
    globe = superellipsoid((0, 0, 3.9), (0.2, 0.2, 0.26), _LAMP, num_rings=6, num_sides=10)
    hat = superellipsoid((0, 0, 4.15), (0.27, 0.27, 0.07), _DARK_STEEL, num_rings=4, num_sides=10)
    return Mesh.joined((pole, globe, hat))


def _face(
    sides: int, radius: float, finish: Finish, out: float, height: float, turn: float
) -> Mesh:
    """A regular polygon that looks along x."""
    angles = turn + np.arange(sides) * 2 * np.pi / sides
    corners = np.stack(
        (np.full(sides, out), radius * np.cos(angles), height + radius * np.sin(angles)), axis=1
    )
    return polygon(corners, finish)


def _plate(
    half: tuple[float, float], finish: Finish, out: float, center: tuple[float, float]
) -> Mesh:
    """A rectangle that looks along x, by its half width and height and its middle (y, z)."""
    (w, h), (y, z) = half, center
    corners = [[out, y - w, z - h], [out, y + w, z - h], [out, y + w, z + h], [out, y - w, z + h]]
    return quads(np.array([corners]), finish)


def _sign(sides: int, radius: float, rings: list[tuple[float, Finish]], turn: float) -> Mesh:
    """A sign of nested polygons, each a share of the whole, on a post."""
    height = 2.35
    back = _face(sides, radius, Finish(Material.METAL, (0.42, 0.43, 0.44)), 0.03, height, turn)
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
    back = _plate(half, Finish(Material.METAL, (0.42, 0.43, 0.44)), 0.03, center)
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
    back = _plate((1.25, 0.75), Finish(Material.METAL, (0.42, 0.43, 0.44)), 0.05, (0.0, 2.6))
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


def _bollard() -> Mesh:
    pole = tube([(0, 0, -0.2), (0, 0, 0.85)], 0.045, _DARK_STEEL, num_sides=9)
    band = tube([(0, 0, 0.66), (0, 0, 0.76)], 0.048, _WHITE, num_sides=9, capped=False)
    return Mesh.joined((pole, band))


def _delineator() -> Mesh:
    white = Finish(Material.PLASTIC, (0.75, 0.75, 0.73))
    body = box((0, 0, 0.42), (0.05, 0.06, 0.52), white)
    belt = box((0, 0, 0.74), (0.052, 0.062, 0.11), _BLACK)
    return Mesh.joined(
        (body, belt, *(_plate((0.025, 0.08), _WHITE, x, (0.0, 0.74)) for x in (-0.056, 0.056)))
    )


def _bin() -> Mesh:
    finish = Finish(Material.PLASTIC, (0.30, 0.11, 0.02))
    return Mesh.joined(
        (_post(1.15), tube([(0.2, 0, 0.45), (0.2, 0, 1.05)], (0.15, 0.18), finish, num_sides=10))
    )


def _wheeled_bin() -> Mesh:
    body = Finish(Material.PLASTIC, (0.05, 0.055, 0.055))
    lid = Finish(Material.PLASTIC, (0.30, 0.24, 0.03))
    wheels = [
        tube([(-0.24, y, 0.1), (-0.24, y + 0.05, 0.1)], 0.1, _BLACK, num_sides=10)
        for y in (-0.28, 0.23)
    ]
    return Mesh.joined(
        (
            box((0, 0, 0.5), (0.27, 0.25, 0.43), body),
            box((0, 0, 0.97), (0.3, 0.28, 0.045), lid),
            *wheels,
        )
    )


def _bench() -> Mesh:
    wood = Finish(Material.WOOD, (0.30, 0.17, 0.08))
    slats = [box((x, 0, 0.44), (0.055, 0.85, 0.018), wood) for x in (-0.13, 0.0, 0.13)]
    backs = [
        box((-0.23 - 0.05 * row, 0, 0.62 + 0.16 * row), (0.018, 0.85, 0.055), wood)
        for row in range(2)
    ]
    legs = [box((-0.05, y, 0.2), (0.2, 0.03, 0.24), _DARK_STEEL) for y in (-0.6, 0.6)]
    return Mesh.joined((*slats, *backs, *legs))


def _cabinet() -> Mesh:
    return box((0, 0, 0.5), (0.17, 0.45, 0.62), Finish(Material.PLASTIC, (0.36, 0.37, 0.33)))


def _letter_box() -> Mesh:
    yellow = Finish(Material.PLASTIC, (0.80, 0.52, 0.01))
    return Mesh.joined((_post(0.7), box((0, 0, 1.0), (0.2, 0.28, 0.36), yellow)))


def _advert_column() -> Mesh:
    poster = Finish(Material.PLASTIC, (0.50, 0.42, 0.30))
    body = tube([(0, 0, -0.1), (0, 0, 2.9)], 0.62, poster, num_sides=18)
    hat = superellipsoid((0, 0, 2.95), (0.74, 0.74, 0.25), _DARK_STEEL, num_rings=5, num_sides=16)
    return Mesh.joined((body, hat))


def _shelter() -> Mesh:
    glass = Finish(Material.GLASS, (0.45, 0.50, 0.48))
    posts = [
        box((x, y, 1.15), (0.035, 0.035, 1.25), _DARK_STEEL)
        for x in (-0.65, 0.65)
        for y in (-1.8, 1.8)
    ]
    roof = box((0.05, 0, 2.42), (0.85, 2.0, 0.06), _DARK_STEEL)
    back = _plate((1.75, 0.95), glass, -0.65, (0.0, 1.3))
    seat = box((-0.4, 0, 0.45), (0.17, 1.2, 0.03), Finish(Material.WOOD, (0.35, 0.2, 0.1)))
    ends = [
        quads(np.array([[[-0.6, y, 0.3], [0.2, y, 0.3], [0.2, y, 2.2], [-0.6, y, 2.2]]]), glass)
        for y in (-1.8, 1.8)
    ]
    return Mesh.joined((*posts, roof, back, seat, *ends))


def _bicycle_stand() -> Mesh:
    hoops = []
    for row in range(4):
        y = 0.8 * (row - 1.5)
        path = [
            (-0.35, y, -0.1),
            (-0.35, y, 0.75),
            (-0.25, y, 0.85),
            (0.25, y, 0.85),
            (0.35, y, 0.75),
            (0.35, y, -0.1),
        ]
        hoops.append(tube(path, 0.025, _STEEL, num_sides=6, capped=False))
    return Mesh.joined(hoops)


def _planter() -> Mesh:
    stone = Finish(Material.CONCRETE, (0.45, 0.44, 0.41))
    green = Finish(Material.LEAF, (0.06, 0.12, 0.03))
    plants = superellipsoid((0, 0, 0.62), (0.48, 0.48, 0.38), green, num_rings=6, num_sides=12)
    return Mesh.joined((box((0, 0, 0.25), (0.55, 0.55, 0.3), stone), plants))


def _wire_pole() -> Mesh:
    wood = Finish(Material.BARK, (0.20, 0.15, 0.11))
    pole = tube([(0, 0, -0.3), (0, 0, 7.6)], (0.13, 0.10), wood, num_sides=8)
    bar = box((0, 0, 7.2), (0.05, 0.7, 0.05), wood)
    knobs = [box((0, y, 7.3), (0.03, 0.03, 0.06), _BLACK) for y in (-0.62, 0.0, 0.62)]
    return Mesh.joined((pole, bar, *knobs))


_MAKERS: Final = {
    Item.ARM_LAMP: _arm_lamp,
    Item.POST_LAMP: _post_lamp,
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
    Item.BOLLARD: _bollard,
    Item.DELINEATOR: _delineator,
    Item.BIN: _bin,
    Item.WHEELED_BIN: _wheeled_bin,
    Item.BENCH: _bench,
    Item.CABINET: _cabinet,
    Item.LETTER_BOX: _letter_box,
    Item.ADVERT_COLUMN: _advert_column,
    Item.SHELTER: _shelter,
    Item.BICYCLE_STAND: _bicycle_stand,
    Item.PLANTER: _planter,
    Item.WIRE_POLE: _wire_pole,
}


def add_boxes_along(
    batch: QuadBatch,
    line: Float[np.ndarray, "num_points 3"],
    finish: Finish,
    *,
    half_width: float,
    heights: tuple[float, float],
) -> None:
    """A wall or rail along a line of world points, from one height above it to another."""
    steps = np.diff(line, axis=0)
    lengths = np.hypot(steps[:, 0], steps[:, 1])
    low, high = heights
    # Pieces reach a little into each other, or bends would gape.
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
    """Upright posts or pickets with their feet at places on the ground."""
    halves = np.tile(half_size, (len(places), 1))
    batch.add(box_corners(places + np.array([0, 0, half_size[2]]), halves, yaws), finish)

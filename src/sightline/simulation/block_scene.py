"""The layout of a street built from blocks: houses, trees, lamps and road users.

LiDAR frame (x forward along the street, y left, z up), metres; the LiDAR stands in the right lane
of a two-way street with parked cars on both sides.
"""

from dataclasses import dataclass

import numpy as np

from sightline.geometry.projection import KITTI_LIDAR_HEIGHT_M
from sightline.simulation.block_rays import Block, Vector

GROUND_Z = -KITTI_LIDAR_HEIGHT_M
KERBS_Y = (-4.3, 7.6)
"""Right and left edge of the road."""
CENTRE_LINE_Y = 1.75
CROSSING_X = (23.0, 26.0)

_HOUSES_Y = (-8.4, 11.8)
_PAVEMENT_HEIGHT = 0.12
_STREET_X = (-60.0, 110.0)
_PLASTER: tuple[Vector, ...] = (
    (0.80, 0.72, 0.58),
    (0.66, 0.42, 0.34),
    (0.72, 0.74, 0.74),
    (0.84, 0.80, 0.70),
    (0.58, 0.62, 0.60),
    (0.78, 0.60, 0.46),
)
_PAINT: tuple[Vector, ...] = (
    (0.62, 0.10, 0.10),
    (0.14, 0.28, 0.52),
    (0.78, 0.79, 0.80),
    (0.16, 0.17, 0.19),
    (0.45, 0.48, 0.50),
    (0.80, 0.66, 0.22),
    (0.20, 0.40, 0.34),
)
_CLOTHES: tuple[Vector, ...] = (
    (0.70, 0.22, 0.18),
    (0.20, 0.34, 0.60),
    (0.85, 0.70, 0.30),
    (0.30, 0.46, 0.34),
    (0.78, 0.78, 0.74),
)
_SKIN: Vector = (0.80, 0.62, 0.50)
_TROUSERS: Vector = (0.18, 0.20, 0.27)


@dataclass(frozen=True, kw_only=True)
class Thing:
    """Blocks that belong together."""

    blocks: tuple[Block, ...]
    class_name: str | None = None
    """KITTI's name of a road user; None for what stands around."""
    box3d: tuple[float, ...] = ()
    """Of a road user: x, y, z of the centre, length, width, height, yaw."""


@dataclass(frozen=True, kw_only=True)
class _Part:
    """A block in the frame of its thing: origin on the ground, x ahead."""

    at: Vector
    """Centre of the bottom face."""
    size: Vector
    surface: str
    color: Vector


def build_street(rng: np.random.Generator) -> tuple[Thing, ...]:
    """A street drawn by chance; road users come first."""
    users = [*_traffic(rng), *_parked_cars(rng), *_people(rng)]
    return (*users, *_pavements(), *_houses(rng), *_greenery(rng), *_lamps())


def _assemble(
    parts: list[_Part], x: float, y: float, yaw: float, *, class_name: str | None = None, z: float
) -> Thing:
    cos, sin = float(np.cos(yaw)), float(np.sin(yaw))
    yaw = float((yaw + np.pi) % (2 * np.pi) - np.pi)
    blocks = []
    for part in parts:
        ahead, aside, up = part.at
        center = (x + cos * ahead - sin * aside, y + sin * ahead + cos * aside, z + up)
        raised = (center[0], center[1], center[2] + part.size[2] / 2)
        blocks.append(
            Block(center=raised, size=part.size, yaw=yaw, surface=part.surface, color=part.color)
        )
    low = np.min([np.array(part.at[:2]) - np.array(part.size[:2]) / 2 for part in parts], axis=0)
    high = np.max([np.array(part.at[:2]) + np.array(part.size[:2]) / 2 for part in parts], axis=0)
    top = max(part.at[2] + part.size[2] for part in parts)
    ahead, aside = ((low + high) / 2).tolist()
    center = (x + cos * ahead - sin * aside, y + sin * ahead + cos * aside, z + top / 2)
    box = (*center, *(high - low).tolist(), top, yaw)
    return Thing(blocks=tuple(blocks), class_name=class_name, box3d=box if class_name else ())


def _car(rng: np.random.Generator, x: float, y: float, yaw: float) -> Thing:
    length, width = rng.uniform(3.6, 4.5), rng.uniform(1.60, 1.80)
    height = rng.uniform(1.42, 1.62)
    color = _PAINT[rng.integers(len(_PAINT))]
    waist = 0.57 * height
    axle = 0.5 * length - 0.58  # close to the ends, where little road is left below the box
    rubber = (0.07, 0.07, 0.08)
    parts = [
        _Part(
            at=(0.0, 0.0, 0.24),
            size=(length, width - 0.02, waist - 0.24),
            surface="car",
            color=color,
        ),
        _Part(
            at=(-0.07 * length, 0.0, waist),
            size=(0.56 * length, 0.86 * width, height - waist),
            surface="cabin",
            color=color,
        ),
    ]
    parts += [
        _Part(at=(ahead, aside, 0.0), size=(0.6, 0.22, 0.6), surface="wheel", color=rubber)
        for ahead in (-axle, axle)
        for aside in (-0.5 * width + 0.11, 0.5 * width - 0.11)
    ]
    return _assemble(parts, x, y, yaw, class_name="Car", z=GROUND_Z)


def _pedestrian(rng: np.random.Generator, x: float, y: float, yaw: float, z: float) -> Thing:
    size = rng.uniform(0.93, 1.06)
    color = _CLOTHES[rng.integers(len(_CLOTHES))]
    parts = [
        _Part(
            at=(0.13, 0.09, 0.0), size=(0.17, 0.15, 0.80 * size), surface="plain", color=_TROUSERS
        ),
        _Part(
            at=(-0.13, -0.09, 0.0), size=(0.17, 0.15, 0.80 * size), surface="plain", color=_TROUSERS
        ),
        _Part(
            at=(0.0, 0.0, 0.78 * size), size=(0.28, 0.46, 0.66 * size), surface="plain", color=color
        ),
        _Part(at=(0.02, 0.0, 1.47 * size), size=(0.20, 0.18, 0.25), surface="plain", color=_SKIN),
    ]
    return _assemble(parts, x, y, yaw, class_name="Pedestrian", z=z)


def _cyclist(rng: np.random.Generator, x: float, y: float, yaw: float) -> Thing:
    color = _CLOTHES[rng.integers(len(_CLOTHES))]
    black, frame = (0.08, 0.08, 0.09), (0.55, 0.12, 0.12)
    parts = [
        _Part(at=(0.53, 0.0, 0.0), size=(0.62, 0.05, 0.64), surface="wheel", color=black),
        _Part(at=(-0.53, 0.0, 0.0), size=(0.62, 0.05, 0.64), surface="wheel", color=black),
        _Part(at=(0.0, 0.0, 0.50), size=(0.9, 0.05, 0.07), surface="plain", color=frame),
        _Part(at=(0.42, 0.0, 0.62), size=(0.06, 0.50, 0.40), surface="plain", color=black),
        _Part(at=(0.0, 0.0, 0.40), size=(0.20, 0.28, 0.55), surface="plain", color=_TROUSERS),
        _Part(at=(0.02, 0.0, 0.92), size=(0.30, 0.42, 0.58), surface="plain", color=color),
        _Part(at=(0.10, 0.0, 1.50), size=(0.22, 0.18, 0.25), surface="plain", color=_SKIN),
    ]
    return _assemble(parts, x, y, yaw, class_name="Cyclist", z=GROUND_Z)


def _traffic(rng: np.random.Generator) -> list[Thing]:
    oncoming = 2 * CENTRE_LINE_Y
    return [
        _car(rng, rng.uniform(14, 19), rng.uniform(-0.2, 0.2), rng.normal(0, 0.02)),
        _car(rng, rng.uniform(33, 44), oncoming + rng.uniform(-0.2, 0.2), np.pi - 0.01),
        _cyclist(rng, rng.uniform(10, 13), oncoming + rng.uniform(0.6, 1.0), np.pi + 0.05),
        _cyclist(rng, rng.uniform(28, 36), -1.6, rng.normal(0, 0.05)),
    ]


def _parked_cars(rng: np.random.Generator) -> list[Thing]:
    cars = []
    for y, yaw, first in ((KERBS_Y[0] + 1.1, 0.0, 4.5), (KERBS_Y[1] - 1.1, np.pi, 6.5)):
        x = first + rng.uniform(0, 3)
        while x < 62:
            on_crossing = CROSSING_X[0] - 4 < x < CROSSING_X[1] + 4
            if rng.random() < 0.62 and not on_crossing:
                cars.append(_car(rng, x, y + rng.normal(0, 0.08), yaw + rng.normal(0, 0.025)))
            x += rng.uniform(5.6, 7.5)
    return cars


def _people(rng: np.random.Generator) -> list[Thing]:
    on_pavement = GROUND_Z + _PAVEMENT_HEIGHT
    crossing = rng.uniform(*CROSSING_X)
    people = [_pedestrian(rng, crossing, rng.uniform(-0.6, 3.0), np.pi / 2, GROUND_Z)]
    for low, high, y in ((8, 14, -5.6), (16, 24, 8.7), (26, 38, -6.3), (40, 50, 8.4)):
        yaw = float(rng.choice([0.0, np.pi])) + rng.normal(0, 0.2)
        people.append(
            _pedestrian(rng, rng.uniform(low, high), y + rng.normal(0, 0.3), yaw, on_pavement)
        )
    return people


def _pavements() -> list[Thing]:
    pavements = []
    for kerb, houses in zip(KERBS_Y, _HOUSES_Y, strict=True):
        for start in np.arange(_STREET_X[0], _STREET_X[1], 17.0).tolist():
            part = _Part(
                at=(0.0, 0.0, 0.0),
                size=(17.0, abs(houses - kerb), _PAVEMENT_HEIGHT),
                surface="pavement",
                color=(0.56, 0.54, 0.51),
            )
            middle = (kerb + houses) / 2
            pavements.append(_assemble([part], start + 8.5, middle, 0.0, z=GROUND_Z))
    return pavements


def _houses(rng: np.random.Generator) -> list[Thing]:
    houses = []
    for side, front in zip((-1, 1), _HOUSES_Y, strict=True):
        x = _STREET_X[0]
        while x < _STREET_X[1]:
            width = rng.uniform(9, 15)
            if rng.random() < 0.16:  # a gap closed by a garden wall
                parts = [
                    _Part(
                        at=(0.0, 0.0, 0.0),
                        size=(width, 0.3, 1.5),
                        surface="plain",
                        color=(0.60, 0.50, 0.42),
                    )
                ]
                houses.append(_assemble(parts, x + width / 2, front + side * 0.5, 0.0, z=GROUND_Z))
            else:
                houses.append(_house(rng, x + width / 2, front, side, width))
            x += width
    end = _house(rng, 0.0, 0.0, 1, 46.0)
    turned = [
        Block(
            center=(_STREET_X[1] + block.center[1], 2.0 - block.center[0], block.center[2]),
            size=block.size,
            yaw=-np.pi / 2,
            surface=block.surface,
            color=block.color,
        )
        for block in end.blocks
    ]
    return [*houses, Thing(blocks=tuple(turned))]


def _house(rng: np.random.Generator, x: float, front: float, side: int, width: float) -> Thing:
    height = 3.2 * rng.integers(2, 5) + 0.8
    depth = 6.0
    roof = rng.uniform(1.6, 2.6)
    parts = [
        _Part(
            at=(0.0, 0.0, 0.0),
            size=(width, depth, height),
            surface="facade",
            color=_PLASTER[rng.integers(len(_PLASTER))],
        ),
        _Part(
            at=(0.0, 0.5 * side, height),
            size=(width - 0.02, depth - 1.0, roof),
            surface="roof",
            color=(0.40, 0.23, 0.19) if rng.random() < 0.6 else (0.30, 0.31, 0.34),
        ),
    ]
    return _assemble(parts, x, front + side * depth / 2, 0.0, z=GROUND_Z)


def _greenery(rng: np.random.Generator) -> list[Thing]:
    trees = []
    for y in (KERBS_Y[0] - 1.0, KERBS_Y[1] + 1.0):
        for start in np.arange(-30, 80, 15.0).tolist():
            green = (rng.uniform(0.20, 0.30), rng.uniform(0.36, 0.46), rng.uniform(0.14, 0.20))
            trunk = rng.uniform(2.2, 2.8)
            parts = [
                _Part(
                    at=(0.0, 0.0, 0.0),
                    size=(0.28, 0.28, trunk + 0.5),
                    surface="plain",
                    color=(0.30, 0.23, 0.17),
                )
            ]
            for up, wide in ((0.0, 2.2), (0.9, 2.9), (2.0, 1.9)):
                shift = rng.uniform(-0.3, 0.3, 2)
                parts.append(
                    _Part(
                        at=(float(shift[0]), float(shift[1]), trunk + up),
                        size=(wide, wide, 1.1),
                        surface="leaves",
                        color=green,
                    )
                )
            x = start + rng.uniform(0, 6)
            trees.append(_assemble(parts, x, y, rng.uniform(0, np.pi / 2), z=GROUND_Z))
    return trees


def _lamps() -> list[Thing]:
    grey = (0.34, 0.36, 0.38)
    parts = [
        _Part(at=(0.0, 0.0, 0.0), size=(0.14, 0.14, 6.4), surface="plain", color=grey),
        _Part(at=(0.8, 0.0, 6.3), size=(1.7, 0.10, 0.10), surface="plain", color=grey),
        _Part(at=(1.6, 0.0, 6.2), size=(0.6, 0.22, 0.12), surface="plain", color=(0.8, 0.8, 0.76)),
    ]
    lamps = []
    for x in (-20.0, 9.0, 38.0, 67.0):
        lamps.append(_assemble(parts, x, KERBS_Y[0] - 0.4, np.pi / 2, z=GROUND_Z))
        lamps.append(_assemble(parts, x + 14.0, KERBS_Y[1] + 0.4, -np.pi / 2, z=GROUND_Z))
    return lamps

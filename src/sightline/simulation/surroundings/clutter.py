"""Simple street objects, from lamps and bins to skips, advertising boards and bicycles.

Faces of `Material.CAR_PAINT` have another colour in each copy.
"""

from collections.abc import Callable, Mapping
from typing import Final

import numpy as np

from sightline.simulation.scene import Material, Mesh
from sightline.simulation.shapes.primitives import Finish, box, superellipsoid, tube

_PAINT: Final = Finish(Material.CAR_PAINT, (0.30, 0.28, 0.26))
_STEEL: Final = Finish(Material.METAL, (0.30, 0.31, 0.32))
_BLACK: Final = Finish(Material.PLASTIC, (0.02, 0.02, 0.02))
_WHITE: Final = Finish(Material.PLASTIC, (0.70, 0.70, 0.68))
_ORANGE: Final = Finish(Material.PLASTIC, (0.60, 0.10, 0.02))
_RED: Final = Finish(Material.RETRO_REFLECTOR, (0.55, 0.04, 0.03))
_STONE: Final = Finish(Material.CONCRETE, (0.36, 0.35, 0.33))
_WOOD: Final = Finish(Material.WOOD, (0.28, 0.19, 0.11))
_POLE: Final = Finish(Material.METAL, (0.38, 0.39, 0.40))
_DARK: Final = Finish(Material.METAL, (0.08, 0.09, 0.09))
_BELT: Final = Finish(Material.RETRO_REFLECTOR, (0.80, 0.80, 0.78))
_LAMP: Final = Finish(Material.HEADLIGHT, (0.75, 0.74, 0.70))
_GLASS: Final = Finish(Material.GLASS, (0.45, 0.50, 0.48))
_BARK: Final = Finish(Material.BARK, (0.20, 0.15, 0.11))
_GREEN: Final = Finish(Material.LEAF, (0.06, 0.12, 0.03))
_YELLOW: Final = Finish(Material.PLASTIC, (0.80, 0.52, 0.01))
_GREY: Final = Finish(Material.PLASTIC, (0.36, 0.37, 0.33))


def _bicycle() -> list[Mesh]:
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
    parts += [tube(bar, 0.02, _PAINT, num_sides=4, capped=False) for bar in bars]
    handle = box((0.34, 0, 1.03), (0.03, 0.28, 0.015), _BLACK)
    return [*parts, handle, box((-0.22, 0, 0.95), (0.13, 0.07, 0.03), _BLACK)]


def _arm_lamp() -> list[Mesh]:
    path = [(0, 0, -0.3), (0, 0, 5.2), (0.12, 0, 6.6), (0.6, 0, 7.15), (1.7, 0, 7.35)]
    return [
        tube(path, (0.10, 0.075, 0.055, 0.05, 0.045), _POLE),
        superellipsoid((2.0, 0, 7.36), (0.42, 0.15, 0.09), _DARK, exponents=(0.6, 0.6)),
        box((2.0, 0, 7.29), (0.35, 0.11, 0.01), _LAMP),
        tube([(0, 0, -0.1), (0, 0, 1.0)], 0.12, _POLE),
    ]


def _bicycle_stand() -> list[Mesh]:
    hoop = ((-0.35, -0.1), (-0.35, 0.75), (-0.25, 0.85), (0.25, 0.85), (0.35, 0.75), (0.35, -0.1))
    return [
        tube([(x, 0.8 * (row - 1.5), z) for x, z in hoop], 0.025, _POLE, num_sides=6, capped=False)
        for row in range(4)
    ]


def _shelter() -> list[Mesh]:
    corners = [(x, y) for x in (-0.65, 0.65) for y in (-1.8, 1.8)]
    return [
        *(box((x, y, 1.15), (0.035, 0.035, 1.25), _DARK) for x, y in corners),
        box((0.05, 0, 2.42), (0.85, 2.0, 0.06), _DARK),
        box((-0.65, 0, 1.3), (0.005, 1.75, 0.95), _GLASS),
        box((-0.4, 0, 0.45), (0.17, 1.2, 0.03), _WOOD),
        *(box((-0.2, y, 1.25), (0.4, 0.005, 0.95), _GLASS) for y in (-1.8, 1.8)),
    ]


def _striped(height: float) -> list[Mesh]:
    """Build a board in red and white across y."""
    return [
        box((0, -0.875 + 0.25 * row, height), (0.018, 0.125, 0.11), _RED if row % 2 else _WHITE)
        for row in range(8)
    ]


def _scaffold() -> list[Mesh]:
    levels, rows = (2.0, 4.0, 6.0), np.arange(-4.0, 4.1, 2.0)
    tubes = [box((x, y, 3.4), (0.025, 0.025, 3.5), _STEEL) for x in (-0.4, 0.4) for y in rows]
    rails = [box((0.4, 0, z + h), (0.02, 4.1, 0.02), _STEEL) for z in levels for h in (0.5, 1)]
    return tubes + rails + [box((0, 0, z), (0.4, 4.1, 0.025), _WOOD) for z in levels]


CLUTTER: Final[Mapping[str, Callable[[], list[Mesh]]]] = {
    "arm lamp": _arm_lamp,
    "post lamp": lambda: [
        tube([(0, 0, -0.3), (0, 0, 3.6)], (0.065, 0.045), _DARK),
        superellipsoid((0, 0, 3.9), (0.2, 0.2, 0.26), _LAMP, num_rings=6, num_sides=10),
        superellipsoid((0, 0, 4.15), (0.27, 0.27, 0.07), _DARK, num_rings=4, num_sides=10),
    ],
    "bollard": lambda: [
        tube([(0, 0, -0.2), (0, 0, 0.85)], 0.045, _DARK, num_sides=9),
        tube([(0, 0, 0.66), (0, 0, 0.76)], 0.048, _BELT, num_sides=9, capped=False),
    ],
    "delineator": lambda: [
        box((0, 0, 0.42), (0.05, 0.06, 0.52), _WHITE),
        box((0, 0, 0.74), (0.052, 0.062, 0.11), _BLACK),
        box((0, 0, 0.74), (0.056, 0.025, 0.08), _BELT),
    ],
    "bin": lambda: [
        tube([(0, 0, -0.3), (0, 0, 1.15)], 0.03, _POLE, num_sides=7),
        tube([(0.2, 0, 0.45), (0.2, 0, 1.05)], (0.15, 0.18), _ORANGE, num_sides=10),
    ],
    "wheeled bin": lambda: [
        box((0, 0, 0.5), (0.27, 0.25, 0.43), _BLACK),
        box((0, 0, 0.97), (0.3, 0.28, 0.045), _PAINT),
        *(tube([(-0.24, y, 0.1), (-0.24, y + 0.05, 0.1)], 0.1, _BLACK) for y in (-0.28, 0.23)),
    ],
    "bench": lambda: [
        *(box((x, 0, 0.44), (0.055, 0.85, 0.018), _WOOD) for x in (-0.13, 0.0, 0.13)),
        *(box((-0.23 - d, 0, 0.62 + 3.2 * d), (0.018, 0.85, 0.055), _WOOD) for d in (0, 0.05)),
        *(box((-0.05, y, 0.2), (0.2, 0.03, 0.24), _DARK) for y in (-0.6, 0.6)),
    ],
    "cabinet": lambda: [box((0, 0, 0.5), (0.17, 0.45, 0.62), _GREY)],
    "letter box": lambda: [
        tube([(0, 0, -0.3), (0, 0, 0.7)], 0.03, _POLE), box((0, 0, 1.0), (0.2, 0.28, 0.36), _YELLOW)
    ],
    "advert column": lambda: [
        tube([(0, 0, -0.1), (0, 0, 2.9)], 0.62, _PAINT, num_sides=18),
        superellipsoid((0, 0, 2.95), (0.74, 0.74, 0.25), _DARK, num_rings=5, num_sides=16),
    ],
    "shelter": _shelter,
    "bicycle stand": _bicycle_stand,
    "planter": lambda: [
        box((0, 0, 0.25), (0.55, 0.55, 0.3), _STONE),
        superellipsoid((0, 0, 0.62), (0.48, 0.48, 0.38), _GREEN, num_rings=6, num_sides=12),
    ],
    "wire pole": lambda: [
        tube([(0, 0, -0.3), (0, 0, 7.6)], (0.13, 0.10), _BARK),
        box((0, 0, 7.2), (0.05, 0.7, 0.05), _BARK),
        *(box((0, y, 7.3), (0.03, 0.03, 0.06), _BLACK) for y in (-0.62, 0.0, 0.62)),
    ],
    "bicycle": _bicycle,
    "hydrant": lambda: [
        tube([(0, 0, -0.1), (0, 0, 0.75), (0, 0, 0.95)], (0.11, 0.11, 0.05), _RED, num_sides=10),
        tube([(0, -0.2, 0.62), (0, 0.2, 0.62)], 0.06, _STEEL),
    ],
    "pillar": lambda: [
        box((0, 0, 0.7), (0.22, 0.22, 0.8), _STONE), box((0, 0, 1.54), (0.28, 0.28, 0.05), _STONE)
    ],
    "grit box": lambda: [
        box((0, 0, 0.33), (0.36, 0.6, 0.38), _PAINT), box((0, 0, 0.75), (0.4, 0.64, 0.05), _BLACK)
    ],
    "poster": lambda: [
        box((0, 0, 0.3), (0.1, 0.35, 0.45), _STEEL),
        box((0, 0, 1.6), (0.11, 0.68, 0.98), _BLACK),
        box((0, 0, 1.6), (0.12, 0.60, 0.88), _PAINT),
        superellipsoid((0, 0.1, 1.45), (0.125, 0.25, 0.6), _WHITE, num_rings=6, num_sides=8),
    ],
    "billboard": lambda: [
        *(box((-0.08, y, 0.6), (0.06, 0.06, 0.9), _WOOD) for y in (-1.3, 1.3)),
        box((0, 0, 2.2), (0.05, 1.85, 1.3), _WHITE),
        box((0, 0, 2.2), (0.058, 1.75, 1.2), _PAINT),
        box((0, 0.2, 1.55), (0.064, 1.3, 0.2), _WHITE),
    ],
    "sandwich board": lambda: [
        box((0, 0, 0.5), (0.16, 0.33, 0.5), _PAINT), box((0, 0, 0.6), (0.166, 0.22, 0.2), _WHITE)
    ],
    "bottle bank": lambda: [
        superellipsoid(
            (0, 0, 0.8), (0.85, 0.85, 0.85), _PAINT, exponents=(0.4, 0.5), num_rings=7
        ),
        box((0.78, 0, 1.15), (0.1, 0.15, 0.12), _BLACK),
    ],
    "parasol": lambda: [
        tube([(0, 0, -0.1), (0, 0, 2.5)], 0.03, _STEEL, num_sides=6),
        tube([(0, 0, 2.05), (0, 0, 2.6)], (1.4, 0.05), _PAINT),
        tube([(0, 0, 0.72), (0, 0, 0.75)], 0.38, _WOOD, num_sides=10),
    ],
    "cone": lambda: [
        box((0, 0, 0.02), (0.19, 0.19, 0.02), _BLACK),
        tube([(0, 0, 0.03), (0, 0, 0.75)], (0.14, 0.03), _ORANGE),
        tube([(0, 0, 0.35), (0, 0, 0.5)], (0.096, 0.073), _WHITE, capped=False),
    ],
    "barrier": lambda: [
        *(box((0, y, 0.05), (0.35, 0.1, 0.06), _BLACK) for y in (-0.9, 0.9)),
        *(box((0, y, 0.55), (0.025, 0.025, 0.5), _STEEL) for y in (-0.9, 0.9)),
        *_striped(0.45),
        *_striped(0.93),
    ],
    "skip": lambda: [
        superellipsoid((0, 0, 0.7), (1.75, 0.9, 0.68), _PAINT, exponents=(0.15, 0.15), num_rings=6),
        superellipsoid((0, 0, 1.25), (1.4, 0.7, 0.35), _STONE, num_rings=5, num_sides=10),
    ],
    "site cabin": lambda: [
        box((0, 0, 1.3), (1.2, 2.4, 1.25), _PAINT),
        box((0, 0, 2.58), (1.25, 2.45, 0.05), _STEEL),
        box((0, -1.4, 1.15), (1.215, 0.45, 1.0), _WHITE),
        box((0, 0.8, 1.6), (1.215, 0.6, 0.45), _BLACK),
    ],
    "scaffold": _scaffold,
}  # fmt: skip
"""Parts of each object; its foot is at the origin, its face looks along x."""

"""Objects that look like people or cars to a LiDAR: beacons, low signs, masts, bare trunks, heaps.

Faces of `Material.CAR_PAINT` have another colour in each copy.
"""

from collections.abc import Callable, Mapping
from typing import Final

import numpy as np

from sightline.simulation.materials import Material
from sightline.simulation.meshes.primitives import Finish, box, moved, superellipsoid, tube
from sightline.simulation.scene import Mesh

_PAINT: Final = Finish(Material.CAR_PAINT, (0.30, 0.28, 0.26))
_STEEL: Final = Finish(Material.METAL, (0.38, 0.39, 0.40))
_BLACK: Final = Finish(Material.PLASTIC, (0.02, 0.02, 0.02))
_AMBER: Final = Finish(Material.PLASTIC, (0.80, 0.40, 0.01))
_RED: Final = Finish(Material.RETRO_REFLECTOR, (0.55, 0.04, 0.03))
_WHITE: Final = Finish(Material.RETRO_REFLECTOR, (0.80, 0.80, 0.78))
_BLUE: Final = Finish(Material.RETRO_REFLECTOR, (0.02, 0.08, 0.36))
_BARK: Final = Finish(Material.BARK, (0.20, 0.15, 0.11))
_WOOD: Final = Finish(Material.WOOD, (0.30, 0.22, 0.14))
_GREEN: Final = Finish(Material.LEAF, (0.08, 0.15, 0.04))
_SAND: Final = Finish(Material.SOIL, (0.30, 0.24, 0.16))
_GRIT: Final = Finish(Material.GRAVEL, (0.26, 0.25, 0.24))


def _post(height: float, radius: float, finish: Finish = _STEEL) -> Mesh:
    return tube([(0, 0, -0.3), (0, 0, height)], radius, finish, num_sides=9)


def _beacon() -> list[Mesh]:
    """Build a striped panel on a foot, as used at road works."""
    stripes = [
        box((0, 0, 0.22 + 0.2 * row), (0.03, 0.125, 0.1), _WHITE if row % 2 else _RED)
        for row in range(5)
    ]
    return [box((0, 0, 0.02), (0.2, 0.4, 0.1), _BLACK), *stripes]


def _lit_beacon() -> list[Mesh]:
    lamp = superellipsoid((0, 0, 1.28), (0.07, 0.1, 0.1), _AMBER, num_rings=6, num_sides=10)
    return [*_beacon(), box((0, 0, 1.15), (0.06, 0.09, 0.06), _AMBER), lamp]


def _chevrons() -> list[Mesh]:
    """Build a board of arrows at the height of a person's chest, on a post."""
    boards = [
        box((0.06, -0.2 + 0.1 * row, 0.95), (0.015, 0.05, 0.26), _RED if row % 2 else _WHITE)
        for row in range(5)
    ]
    return [_post(1.25, 0.04), *boards]


def _signal_mast() -> list[Mesh]:
    """Build a pedestrian light with a button."""
    return [
        _post(3.3, 0.07),
        box((0.16, 0, 2.4), (0.1, 0.13, 0.36), _BLACK),
        box((0.12, 0.0, 1.55), (0.06, 0.08, 0.16), _BLACK),
        box((0.1, 0.03, 1.05), (0.05, 0.06, 0.11), _AMBER),
    ]


def _poster_pole() -> list[Mesh]:
    """Build a lamp pole with placards tied to both sides."""
    boards = [box((out, 0, 1.0), (0.012, 0.3, 0.43), _PAINT) for out in (-0.1, 0.1)]
    return [_post(5.0, 0.075), *boards]


def _staked_tree() -> list[Mesh]:
    """Build a young tree between three stakes."""
    turns = np.arange(3) * 2 * np.pi / 3
    feet = [(0.33 * float(np.cos(turn)), 0.33 * float(np.sin(turn)), 0.0) for turn in turns]
    rail = [*feet, feet[0]]
    return [
        *(moved(tube([(0, 0, -0.2), (0, 0, 1.6)], 0.04, _WOOD), foot) for foot in feet),
        tube([(x, y, 1.5) for x, y, _ in rail], 0.03, _WOOD, num_sides=5),
        _post(3.2, 0.04, _BARK),
        superellipsoid((0, 0, 3.6), (0.9, 0.9, 1.0), _GREEN, num_rings=7),
    ]


DECOYS: Final[Mapping[str, Callable[[], list[Mesh]]]] = {
    "beacon": _beacon,
    "lit beacon": _lit_beacon,
    "keep-right sign": lambda: [
        _post(0.9, 0.035), tube([(0.05, 0, 1.1), (0.08, 0, 1.1)], 0.3, _BLUE, num_sides=18)
    ],
    "chevrons": _chevrons,
    "signal mast": _signal_mast,
    "poster pole": _poster_pole,
    "display stand": lambda: [
        box((0, 0, 0.0), (0.28, 0.3, 0.16), _BLACK),
        superellipsoid((0, 0, 0.75), (0.05, 0.32, 0.58), _PAINT, exponents=(0.4, 0.4)),
    ],
    "litter bin": lambda: [
        _post(0.9, 0.23, _PAINT), superellipsoid((0, 0, 0.92), (0.25, 0.25, 0.12), _BLACK)
    ],
    "parking meter": lambda: [_post(1.1, 0.06), box((0, 0, 1.4), (0.11, 0.15, 0.32), _PAINT)],
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

"""Buses, and lorries for special loads: tankers, tippers, concrete mixers, refuse lorries."""

from collections.abc import Callable
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from sightline.simulation.bodies.body import BLACK_PLASTIC, GAP, TAIL_LIGHT, TINTED_GLASS
from sightline.simulation.bodies.car_parts import CHROME, LAMP_GLASS, ORANGE_LAMP, plate
from sightline.simulation.bodies.coachwork import Coachwork, Face, Panel, coachwork_mesh
from sightline.simulation.bodies.models import ActorModel, RigidShape, Size
from sightline.simulation.bodies.trucks import (
    CAB_LENGTH,
    FRONT_AXLE,
    LIVERIES,
    RIM,
    STEEL,
    driver_cab,
    ladder_frame,
    make_truck,
    rear_end,
    tank_and_battery,
    wheel_axles,
)
from sightline.simulation.scene import Material, Mesh
from sightline.simulation.shapes.edits import both_sides, fitted, turned
from sightline.simulation.shapes.primitives import Finish, box, moved, superellipsoid, tube

_SIGN: Final = Finish(Material.HEADLIGHT, (0.55, 0.30, 0.02))
_JOINT_M: Final = 0.9  # length of an articulated bus's bellows
_BUS_WHEEL_M: Final = 0.48


class HeavyKind(NamedTuple):
    """Kind of heavy vehicle: its share, its size with deviations, and the maker of its parts."""

    share: float
    mean_size: Size
    deviation: Size
    make: Callable[[np.random.Generator, Size], list[Mesh]]


def make_heavy_vehicle(rng: np.random.Generator, kind: str | None = None) -> ActorModel:
    """Draw a lorry of any kind or a bus; KITTI's class of all of them is Truck.

    Raises:
        ValueError: The kind is none of `HEAVY_KINDS`.
    """
    if kind is not None and kind not in HEAVY_KINDS:
        raise ValueError(f"no heavy vehicle is called {kind!r}; use one of {list(HEAVY_KINDS)}")
    if kind is None:
        shares = np.cumsum([each.share for each in HEAVY_KINDS.values()])
        row = int(np.searchsorted(shares, rng.random(), side="right"))
        if row == len(shares):
            return make_truck(rng)
        kind = list(HEAVY_KINDS)[row]
    chosen = HEAVY_KINDS[kind]
    around = np.clip(rng.standard_normal(3), -1.8, 1.8) * chosen.deviation
    size = Size(*(np.array(chosen.mean_size) + around).tolist())
    mesh = fitted(Mesh.joined(chosen.make(rng, size)), size)
    return ActorModel(class_name="Truck", size_lwh=size, shape=RigidShape(mesh=mesh))


def _paint(rng: np.random.Generator, material: Material = Material.CAR_PAINT) -> Finish:
    return Finish(material, LIVERIES[int(rng.integers(len(LIVERIES)))])


def _city_bus(rng: np.random.Generator, size: Size) -> list[Mesh]:
    return _bus(rng, size, sill=1.0, decks=1)


def _coach(rng: np.random.Generator, size: Size) -> list[Mesh]:
    return _bus(rng, size, sill=1.75, decks=1)


def _double_decker(rng: np.random.Generator, size: Size) -> list[Mesh]:
    return _bus(rng, size, sill=1.0, decks=2)


def _articulated_bus(rng: np.random.Generator, size: Size) -> list[Mesh]:
    """Build two parts with bellows between them."""
    paint, band = _paint(rng), _paint(rng)
    lead = 0.56 * size.length - _JOINT_M / 2
    trail = size.length - lead - _JOINT_M
    front = Size(lead, size.width, size.height)
    back = Size(trail, size.width, size.height)
    bellows = box(
        (-lead - _JOINT_M / 2, 0, 0.5 * size.height + 0.1),
        (_JOINT_M / 2 + 0.05, 0.46 * size.width, 0.5 * size.height - 0.2),
        BLACK_PLASTIC,
    )
    return [
        *_bus_body(rng, front, paint, band, 1.0, 1, (True, False)),
        bellows,
        *(
            moved(part, (-lead - _JOINT_M, 0, 0))
            for part in _bus_body(rng, back, paint, band, 1.0, 1, (False, True))
        ),
    ]


def _bus(rng: np.random.Generator, size: Size, *, sill: float, decks: int) -> list[Mesh]:
    return _bus_body(rng, size, _paint(rng), _paint(rng), sill, decks, (True, True))


def _bus_body(
    rng: np.random.Generator,
    size: Size,
    paint: Finish,
    band: Finish,
    sill: float,
    decks: int,
    ends: tuple[bool, bool],
) -> list[Mesh]:
    """Build a bus with its front at x = 0; `ends` tell whether it has a front and a rear."""
    length, width, height = size
    half, reach, low = width / 2, length / 2, 0.32
    rows = [(sill, 0.86 * height)] if decks == 1 else [(sill, 0.44 * height), (2.55, 0.9 * height)]
    work = Coachwork(
        length=length,
        width=width - 0.04,
        low=low,
        high=height - 0.06,
        corner=0.16,
        crown=0.06,
        profile=(
            (low, 0.06, 0.02),
            (0.9, 0.0, 0.0),
            (1.4, 0.02, 0.0),
            (height - 0.5, 0.14, 0.03),
            (height, 0.30, 0.12),
        ),
        rear_leans=ends[1],
    )
    panels = [
        Panel(Face.SIDES, -9, 9, low, 0.45, BLACK_PLASTIC),
        Panel(Face.SIDES, -9, 9, 0.62, sill - 0.12, band),
    ]
    for bottom, top in rows:
        panels.append(
            Panel(Face.SIDES, 0.25 - reach, reach - 0.25, bottom - 0.05, top + 0.05, BLACK_PLASTIC)
        )
        edges = np.linspace(0.3 - reach, reach - 0.9, max(3, round(length / 1.5)) + 1).tolist()
        panels += [
            Panel(Face.SIDES, start + 0.03, end - 0.03, bottom, top, TINTED_GLASS)
            for start, end in pairwise(edges)
        ]
    panels += _doors(reach, rows[0][1])
    if ends[0]:
        panels += [
            Panel(Face.FRONT, 0, half - 0.12, 0.95, 0.93 * height, BLACK_PLASTIC),
            *(Panel(Face.FRONT, 0, half - 0.18, b - 0.05, t, TINTED_GLASS) for b, t in rows),
            Panel(Face.FRONT, 0, 0.6, 0.88 * height, 0.94 * height, _SIGN),
            Panel(Face.FRONT, half - 0.5, half - 0.2, 0.6, 0.78, LAMP_GLASS),
        ]
    if ends[1]:
        panels += [
            Panel(Face.REAR, 0, half - 0.3, *rows[-1], TINTED_GLASS),
            Panel(Face.REAR, 0, half - 0.3, 0.6, sill - 0.05, BLACK_PLASTIC),
            Panel(Face.REAR, half - 0.24, half - 0.1, 0.7, 1.15, TAIL_LIGHT),
        ]
    places = [-0.22 * length, -0.76 * length] if ends[0] else [-0.55 * length]
    parts = [
        moved(coachwork_mesh(work, paint, panels), (-reach, 0, 0)),
        wheel_axles(rng, size, places, _BUS_WHEEL_M),
        *_wheel_arches(places, half),
    ]
    if ends[0]:
        mirror = box((0.12, half - 0.12, 0.75 * height), (0.05, 0.10, 0.22), BLACK_PLASTIC)
        parts += [both_sides(mirror), *plate(rng, 0.0, 0.55, 1)]
    return parts if not ends[1] else [*parts, *plate(rng, -length, 0.75, -1)]


def _doors(reach: float, top: float) -> list[Panel]:
    """Build doors with two leaves at the front and in the middle."""
    panels = []
    for start in (reach - 1.35, -0.15 * reach):
        panels.append(Panel(Face.SIDES, start, start + 1.2, 0.36, top + 0.05, BLACK_PLASTIC))
        panels += [
            Panel(Face.SIDES, leaf, leaf + 0.54, 0.45, top, TINTED_GLASS)
            for leaf in (start + 0.04, start + 0.62)
        ]
    return panels


def _wheel_arches(places: list[float], half: float) -> list[Mesh]:
    depth = 0.012
    arches = [
        tube([(x, half - 0.035, 0.5), (x, half - 0.035 + depth, 0.5)], 0.58, BLACK_PLASTIC)
        for x in places
    ]
    return [both_sides(*arches)]


def _chassis(rng: np.random.Generator, size: Size) -> tuple[list[Mesh], float]:
    """Build cab, frame and wheels of a lorry with two rear axles; its body begins at the second."""
    radius, length = 0.47, size.length
    parts = [
        *driver_cab(rng, size, _paint(rng), min(size.height - 0.1, 2.9), radius),
        *ladder_frame(-0.6, -length + 0.1, radius),
        wheel_axles(rng, size, (FRONT_AXLE, -0.70 * length, -0.70 * length - 1.3), radius),
        *tank_and_battery(-0.45 * length, size, radius),
        *rear_end(rng, -length, size, radius),
    ]
    return parts, -CAB_LENGTH - 0.15


def _tanker(rng: np.random.Generator, size: Size) -> list[Mesh]:
    parts, start = _chassis(rng, size)
    low, reach = 1.05, (size.length + start) / 2
    tall = (size.height - 0.2 - low) / 2
    finish = CHROME if rng.random() < 0.5 else _paint(rng)
    middle = (start - size.length) / 2
    tank = superellipsoid(
        (middle, 0, low + tall), (reach, 0.48 * size.width, tall), finish,
        exponents=(0.9, 0.16), num_rings=13, num_sides=18,
    )  # fmt: skip
    lids = [
        tube([(x, 0, size.height - 0.3), (x, 0, size.height)], 0.28, STEEL)
        for x in np.linspace(middle - 0.6 * reach, middle + 0.6 * reach, 3).tolist()
    ]
    cradle = box((middle, 0.4, low - 0.02), (0.9 * reach, 0.08, 0.12), STEEL)
    mark = box((-size.length + 0.03, 0, 1.0), (0.012, 0.2, 0.15), ORANGE_LAMP)
    return [*parts, tank, *lids, both_sides(cradle), mark]


def _tipper(rng: np.random.Generator, size: Size) -> list[Mesh]:
    """Build an open skip with ribs, sometimes heaped."""
    parts, start = _chassis(rng, size)
    finish = _paint(rng, Material.METAL)
    floor, top, half = 1.15, size.height - 0.25, size.width / 2 - 0.02
    middle, reach, tall = (start - size.length) / 2, (size.length + start) / 2, (top - floor) / 2
    wall = box((middle, half - 0.03, floor + tall), (reach, 0.03, tall), finish)
    ribs = [
        box((x, half, floor + tall), (0.05, 0.02, tall), finish)
        for x in np.arange(start - 0.3, -size.length + 0.2, -0.8).tolist()
    ]
    ends = [
        box((x, 0, floor + tall), (0.03, half, tall), finish)
        for x in (start - 0.03, -size.length + 0.03)
    ]
    heap = (0.9 * reach, 0.85 * half, (size.height - floor) / 2 - 0.02)
    soil = Finish(Material.SOIL, (0.22, 0.17, 0.12))
    load = superellipsoid(
        (middle, 0, floor + heap[2]), heap, soil, exponents=(0.9, 0.5), num_rings=9
    )
    bed = box((middle, 0, floor), (reach, half, 0.06), STEEL)
    return [*parts, both_sides(wall, *ribs), *ends, bed, *([load] if rng.random() < 0.5 else [])]


def _mixer(rng: np.random.Generator, size: Size) -> list[Mesh]:
    """Build a drum that leans forward, with its chute behind."""
    parts, start = _chassis(rng, size)
    middle, reach = (start - size.length) / 2, (size.length + start) / 2
    drum = superellipsoid(
        (0, 0, 0), (0.93 * reach, 0.46 * size.width, 0.46 * size.width), _paint(rng),
        exponents=(1.0, 0.75), num_rings=15, num_sides=20,
    )  # fmt: skip
    lean = np.radians(11.0)
    cos, sin = np.cos(lean), np.sin(lean)
    drum = turned(drum, np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]]))
    height = size.height - 0.46 * size.width - 0.1
    chute = tube([(0.25 - size.length, 0, 2.3), (-size.length, 0, 1.3)], 0.18, RIM)
    posts = box((0.7 - size.length, 0.7, 1.5), (0.08, 0.06, 0.7), STEEL)
    return [*parts, moved(drum, (middle + 0.1, 0, height)), chute, both_sides(posts)]


def _refuse_lorry(rng: np.random.Generator, size: Size) -> list[Mesh]:
    parts, start = _chassis(rng, size)
    finish = Finish(Material.PLASTIC, _paint(rng).color)
    back = 1.5 - size.length
    work = Coachwork(
        length=start - back, width=0.96 * size.width, low=1.0, high=size.height - 0.1, corner=0.12
    )
    hopper = box((0.75 - size.length, 0, 1.75), (0.75, 0.47 * size.width, 0.9), finish)
    mouth = box((0.02 - size.length, 0, 1.35), (0.015, 0.4 * size.width, 0.4), GAP)
    lamp = box((0.1 - size.length, 0.4 * size.width, 2.75), (0.08, 0.08, 0.07), ORANGE_LAMP)
    body = moved(coachwork_mesh(work, finish), ((start + back) / 2, 0, 0))
    return [*parts, body, hopper, mouth, both_sides(lamp)]


HEAVY_KINDS: Final = {
    "city bus": HeavyKind(0.22, Size(12.0, 2.55, 3.1), Size(0.4, 0.03, 0.1), _city_bus),
    "articulated bus": HeavyKind(
        0.08, Size(18.0, 2.55, 3.1), Size(0.3, 0.02, 0.1), _articulated_bus
    ),
    "coach": HeavyKind(0.08, Size(12.6, 2.55, 3.65), Size(0.6, 0.02, 0.12), _coach),
    "minibus": HeavyKind(0.05, Size(7.4, 2.25, 2.85), Size(0.4, 0.08, 0.1), _city_bus),
    "double-decker": HeavyKind(0.04, Size(10.9, 2.52, 4.3), Size(0.4, 0.02, 0.08), _double_decker),
    "tanker": HeavyKind(0.06, Size(9.6, 2.5, 3.3), Size(0.5, 0.03, 0.15), _tanker),
    "tipper": HeavyKind(0.07, Size(8.4, 2.5, 3.1), Size(0.5, 0.03, 0.15), _tipper),
    "concrete mixer": HeavyKind(0.05, Size(8.6, 2.5, 3.75), Size(0.4, 0.03, 0.1), _mixer),
    "refuse lorry": HeavyKind(0.07, Size(8.9, 2.5, 3.4), Size(0.5, 0.03, 0.15), _refuse_lorry),
}
"""Kinds by name; the rest of the shares are the lorries of `make_truck`."""

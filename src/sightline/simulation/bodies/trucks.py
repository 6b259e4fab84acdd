"""Lorries, and vehicles of KITTI's class Misc: trailers, caravans and motorcycles."""

from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np

from sightline.simulation.bodies.body import BLACK_PLASTIC, GAP, TAIL_LIGHT, TINTED_GLASS
from sightline.simulation.bodies.car_parts import (
    CHROME,
    LAMP_GLASS,
    ORANGE_LAMP,
    plate,
    wheel,
    wheels,
)
from sightline.simulation.bodies.coachwork import Coachwork, Face, Panel, coachwork_mesh
from sightline.simulation.bodies.models import KITTI_SIZES, ActorModel, RigidShape, Size
from sightline.simulation.scene import Material, Mesh
from sightline.simulation.shapes.edits import both_sides, fitted
from sightline.simulation.shapes.primitives import (
    Finish,
    box,
    boxes,
    disc,
    moved,
    superellipsoid,
    tube,
)

STEEL = Finish(Material.METAL, (0.05, 0.05, 0.052))
RIM = Finish(Material.METAL, (0.22, 0.22, 0.23))
_MARKING = Finish(Material.RETRO_REFLECTOR, (0.75, 0.12, 0.02))
WOOD = Finish(Material.WOOD, (0.22, 0.14, 0.08))
LIVERIES = (
    (0.66, 0.66, 0.65), (0.62, 0.62, 0.60), (0.40, 0.02, 0.02), (0.03, 0.08, 0.30),
    (0.05, 0.20, 0.10), (0.55, 0.38, 0.03), (0.30, 0.31, 0.33), (0.08, 0.22, 0.42),
)  # fmt: skip
CAB_LENGTH = 2.15  # m
FRONT_AXLE = -1.30  # m, from the front
_ARTICULATED_FROM = 9.8  # m of length


def make_truck(rng: np.random.Generator) -> ActorModel:
    """Draw a lorry of KITTI's sizes; long ones are tractors with a trailer."""
    size = Size(*KITTI_SIZES["Truck"].draw(rng, 1)[0].tolist())
    cab = Finish(Material.CAR_PAINT, LIVERIES[int(rng.integers(len(LIVERIES)))])
    cargo = Finish(Material.PLASTIC, LIVERIES[int(rng.integers(len(LIVERIES)))])
    if size.length > _ARTICULATED_FROM:
        parts = _articulated(rng, size, cab, cargo)
    elif rng.random() < 0.7:
        parts = _box_lorry(rng, size, cab, cargo)
    else:
        parts = _flatbed(rng, size, cab)
    mesh = fitted(Mesh.joined(parts), size)
    return ActorModel(class_name="Truck", size_lwh=size, shape=RigidShape(mesh=mesh))


def driver_cab(
    rng: np.random.Generator, size: Size, paint: Finish, height: float, radius: float
) -> list[Mesh]:
    """Build a driver's cab with its front at x = 0 and its top at `height` [m]."""
    width = min(0.95 * size.width, 2.5)
    low = 0.62 * radius
    sill, top = low + 0.50 * (height - low), low + 0.86 * (height - low)
    half = width / 2
    lamp = low + 0.14 * (height - low)
    roof_inset = 0.22 if height < 2.9 else 0.12
    work = Coachwork(
        length=CAB_LENGTH,
        width=width,
        low=low,
        high=height - 0.05,
        corner=0.16,
        profile=(
            (low, 0.03, 0.03),
            (low + 0.25, 0.0, 0.0),
            (sill - 0.05, 0.03, 0.0),
            (top, 0.17, 0.06),
            (height - 0.05, 0.17 + roof_inset, 0.13),
        ),
    )
    front, back = CAB_LENGTH / 2, -CAB_LENGTH / 2
    door_end = front - 1.20
    panels = [
        Panel(Face.FRONT, 0, 2, 0, low + 0.10, BLACK_PLASTIC),
        Panel(Face.FRONT, 0, 0.62 * half, lamp + 0.18, sill - 0.18, BLACK_PLASTIC),
        Panel(Face.FRONT, 0.62 * half, half, lamp, lamp + 0.20, LAMP_GLASS),
        Panel(Face.FRONT, 0, 2, sill - 0.06, top + 0.05, BLACK_PLASTIC),
        Panel(Face.FRONT, 0, half - 0.20, sill, top, TINTED_GLASS),
        Panel(Face.SIDES, -9, 9, low, low + 0.08, BLACK_PLASTIC),
        Panel(Face.SIDES, door_end, front - 0.22, sill - 0.02, top + 0.02, BLACK_PLASTIC),
        Panel(Face.SIDES, door_end + 0.05, front - 0.27, sill + 0.02, top - 0.02, TINTED_GLASS),
        Panel(Face.SIDES, door_end - 0.06, door_end - 0.045, low + 0.3, top + 0.05, GAP),
        Panel(Face.SIDES, front - 0.20, front - 0.185, low + 0.3, top + 0.05, GAP),
    ]
    shell = moved(coachwork_mesh(work, paint, panels), (back, 0, 0))
    arch_center = (FRONT_AXLE, half + 0.004, radius)
    arch = disc(arch_center, (0, 1, 0), 1.2 * radius, BLACK_PLASTIC, num_sides=24)
    mirror = box((-0.12, half + 0.01, (sill + top) / 2 + 0.05), (0.05, 0.09, 0.20), BLACK_PLASTIC)
    arm = box((-0.14, half - 0.10, top), (0.03, 0.10, 0.02), BLACK_PLASTIC)
    bars = np.linspace(lamp + 0.24, sill - 0.24, 4)
    centers = np.stack((np.full(4, -0.02), np.zeros(4), bars), axis=1)
    grille = boxes(centers, np.tile((0.02, 0.58 * half, 0.015), (4, 1)), CHROME)
    indicator = box((-0.10, 0.985 * half, lamp + 0.30), (0.06, 0.02, 0.04), ORANGE_LAMP)
    pairs = both_sides(arch, mirror, arm, indicator)
    return [shell, pairs, grille, *plate(rng, 0.0, low + 0.20, 1)]


def wheel_axles(
    rng: np.random.Generator, size: Size, places: Sequence[float], radius: float
) -> Mesh:
    """Build a lorry's wheels at the axles' places along x [m]."""
    tyre = 0.32
    one = wheel(rng, radius, tyre, rim=RIM, spokes=1)
    return wheels(one, places, size.width / 2 - tyre / 2 - 0.01, radius)


def rear_end(rng: np.random.Generator, x: float, size: Size, radius: float) -> list[Mesh]:
    """Build under-run bar, lamps, markings and plate at the rear end x [m]."""
    half, z = size.width / 2, 1.15 * radius
    bar = box((x + 0.06, 0, 0.95 * radius), (0.05, 0.9 * half, 0.06), STEEL)
    lamp = box((x + 0.03, 0.78 * half, z + 0.12), (0.03, 0.16, 0.06), TAIL_LIGHT)
    marking = box((x + 0.02, 0.45 * half, z + 0.12), (0.012, 0.22, 0.05), _MARKING)
    strut = box((x + 0.06, 0.42, 1.45 * radius), (0.04, 0.04, 0.5 * radius), STEEL)
    flap = box((x + 0.35, half - 0.2, 0.6 * radius), (0.01, 0.17, 0.25), BLACK_PLASTIC)
    return [bar, both_sides(lamp, marking, strut, flap), *plate(rng, x + 0.02, z, -1)]


def ladder_frame(front: float, back: float, radius: float) -> list[Mesh]:
    """Build the two supporting beams between x `back` and `front` [m]."""
    center = np.array([[(front + back) / 2, side * 0.42, 1.35 * radius] for side in (-1, 1)])
    return [boxes(center, np.tile(((front - back) / 2, 0.06, 0.14), (2, 1)), STEEL)]


def tank_and_battery(x: float, size: Size, radius: float) -> list[Mesh]:
    """Build a fuel tank on one side and a battery box on the other."""
    y = size.width / 2 - 0.36
    tank = superellipsoid(
        (x, y, 1.1 * radius), (0.55, 0.30, 0.30), CHROME, exponents=(0.7, 0.15), num_rings=9
    )
    return [tank, box((x, -y, 1.1 * radius), (0.40, 0.28, 0.25), BLACK_PLASTIC)]


def _cargo_box(
    front: float, back: float, low: float, high: float, width: float, finish: Finish, edge: Finish
) -> Mesh:
    """Build a cargo box with a frame of another finish and a split rear door."""
    half, reach = width / 2, (front - back) / 2
    panels = [
        Panel(Face.SIDES, -reach + 0.12, reach - 0.12, low + 0.16, high - 0.14, finish),
        Panel(Face.REAR, 0, 0.012, low + 0.1, high - 0.1, GAP),
        Panel(Face.REAR, half - 0.40, half - 0.37, low + 0.1, high - 0.1, RIM),
        Panel(Face.FRONT, 0, half, low, high, finish),
    ]
    work = Coachwork(
        length=2 * reach, width=width, low=low, high=high - 0.03, corner=0.04, crown=0.03
    )
    return moved(coachwork_mesh(work, edge, panels), ((front + back) / 2, 0, 0))


def _box_lorry(rng: np.random.Generator, size: Size, cab: Finish, cargo: Finish) -> list[Mesh]:
    length, radius = size.length, min(0.47, 0.15 * size.height)
    cab_height = min(size.height - 0.15, 2.75)
    start = -CAB_LENGTH - 0.12
    edge = Finish(Material.METAL, (0.45, 0.46, 0.47)) if rng.random() < 0.6 else cargo
    parts = driver_cab(rng, size, cab, cab_height, radius)
    parts.append(_cargo_box(start, -length, 2.15 * radius, size.height, size.width, cargo, edge))
    parts += ladder_frame(-0.6, -length + 0.1, radius)
    parts.append(wheel_axles(rng, size, (FRONT_AXLE, -0.74 * length), radius))
    parts += tank_and_battery(-0.45 * length, size, radius)
    return parts + rear_end(rng, -length, size, radius)


def _flatbed(rng: np.random.Generator, size: Size, cab: Finish) -> list[Mesh]:
    length, radius = size.length, min(0.47, 0.15 * size.height)
    start, floor = -CAB_LENGTH - 0.15, 2.2 * radius
    half, middle, reach = size.width / 2, (start - length) / 2, (length + start) / 2
    parts = driver_cab(rng, size, cab, size.height, radius)
    parts += ladder_frame(-0.6, -length + 0.1, radius)
    parts.append(box((middle, 0, floor), (reach, half, 0.07), STEEL))
    board = box((middle, half - 0.02, floor + 0.27), (reach, 0.02, 0.22), RIM)
    rear_board = box((-length + 0.02, 0, floor + 0.27), (0.02, half, 0.22), RIM)
    headboard = box((start - 0.04, 0, floor + 0.55), (0.03, half, 0.55), STEEL)
    parts += [both_sides(board), rear_board, headboard]
    for x in np.arange(start - 0.8, -length + 0.7, -1.3)[: int(rng.integers(0, 6))]:
        tall = float(rng.uniform(0.2, 0.55))
        wood = rng.random() < 0.6
        load = WOOD if wood else Finish(Material.CONCRETE, (0.34, 0.33, 0.31))
        parts.append(box((float(x), 0, floor + 0.07 + tall), (0.5, 0.75 * half, tall), load))
    parts.append(wheel_axles(rng, size, (FRONT_AXLE, -0.76 * length), radius))
    parts += tank_and_battery(-0.45 * length, size, radius)
    return parts + rear_end(rng, -length, size, radius)


def _articulated(rng: np.random.Generator, size: Size, cab: Finish, cargo: Finish) -> list[Mesh]:
    radius = 0.48
    return [
        *driver_cab(rng, size, cab, min(size.height - 0.05, 3.4), radius),
        *ladder_frame(-0.6, -5.4, radius),
        wheel_axles(rng, size, (FRONT_AXLE, -4.6), radius),
        *tank_and_battery(-2.9, size, radius),
        *semitrailer(rng, size, -CAB_LENGTH - 0.45, -size.length, cargo),
    ]


def semitrailer(
    rng: np.random.Generator, size: Size, front: float, back: float, cargo: Finish
) -> list[Mesh]:
    """Build the trailer of a lorry of a size, from x `front` to `back` [m]."""
    low, radius, half = 1.12, 0.48, size.width / 2
    middle, reach = (front + back) / 2, (front - back) / 2
    axles = [back + 1.9 + 1.31 * index for index in range(3 if reach > 4.7 else 2)]
    beam = box((middle, 0.5, low - 0.10), (reach, 0.06, 0.12), STEEL)
    skirt_front, skirt_back = front - 3.3, axles[-1] + 0.75
    skirt = ((skirt_front + skirt_back) / 2, half - 0.06, 0.75)
    rail = box(skirt, (max(skirt_front - skirt_back, 0.2) / 2, 0.02, 0.10), RIM)
    stripe = Finish(Material.PLASTIC, LIVERIES[int(rng.integers(len(LIVERIES)))])
    wide, tall = reach * float(rng.uniform(0.3, 0.7)), 0.18 * (size.height - low)
    band = box((middle, half - 0.005, (low + size.height) / 2), (wide, 0.008, tall), stripe)
    return [
        _cargo_box(front, back, low, size.height, size.width, cargo, RIM),
        both_sides(beam, rail, band),
        wheel_axles(rng, size, axles, radius),
        *rear_end(rng, back, size, radius),
    ]


_WHITE = Finish(Material.CAR_PAINT, (0.66, 0.66, 0.64))
_TWIGS = Finish(Material.WOOD, (0.13, 0.10, 0.06))
_LEATHER = Finish(Material.CLOTH, (0.02, 0.02, 0.02))
_TYRE_M: Final = 0.17


class MiscKind(NamedTuple):
    """Kind of Misc vehicle: its share, its size and its parts."""

    share: float
    mean_size: Size
    deviation: Size
    make: Callable[[np.random.Generator, Size], list[Mesh]]


def make_misc(rng: np.random.Generator, kind: str | None = None) -> ActorModel:
    """Draw a vehicle of KITTI's class Misc, with its drawbar or handlebar ahead.

    Raises:
        ValueError: The kind is none of `MISC_KINDS`.
    """
    names = list(MISC_KINDS)
    if kind is not None and kind not in names:
        raise ValueError(f"no kind of Misc is called {kind!r}; use one of {names}")
    shares = [each.share for each in MISC_KINDS.values()]
    chosen = MISC_KINDS[kind or names[int(rng.choice(len(names), p=shares))]]
    around = np.clip(rng.standard_normal(3), -1.8, 1.8) * chosen.deviation
    size = Size(*(np.array(chosen.mean_size) + around).tolist())
    mesh = fitted(Mesh.joined(chosen.make(rng, size)), size)
    return ActorModel(class_name="Misc", size_lwh=size, shape=RigidShape(mesh=mesh))


def _livery(rng: np.random.Generator, material: Material) -> Finish:
    return Finish(material, LIVERIES[int(rng.integers(len(LIVERIES)))])


def _running_gear(
    rng: np.random.Generator, size: Size, radius: float, bar: float, axles: int
) -> list[Mesh]:
    """Build wheels, drawbar of `bar` [m], jockey wheel and rear end of a trailer."""
    front, back = size.length / 2, -size.length / 2
    middle = (front - bar + back) / 2 - 0.05
    places = [middle + (index - (axles - 1) / 2) * 2.2 * radius for index in range(axles)]
    one = wheel(rng, radius, _TYRE_M, rim=RIM)
    coupling = (front, 0.0, 0.42)
    beam = tube([(front - bar - 0.4, 0.42 * size.width, 0.42), coupling], 0.035, STEEL, num_sides=6)
    fender = box((middle, size.width / 2 - 0.09, 2.1 * radius), (1.2 * radius, 0.09, 0.02), STEEL)
    leg = tube([(front - 0.5 * bar, 0.06, 0.9), (front - 0.5 * bar, 0.06, 0.03)], 0.03, STEEL)
    return [
        wheels(one, places, size.width / 2 - _TYRE_M / 2, radius),
        both_sides(beam, fender) if axles == 1 else both_sides(beam),
        leg,
        *rear_end(rng, back, size, radius),
    ]


def _open_trailer(rng: np.random.Generator, size: Size) -> list[Mesh]:
    """Build boards around a floor, sometimes with a heap on it."""
    bar, floor = 0.24 * size.length, 0.45
    front, back = size.length / 2 - bar, -size.length / 2
    half = size.width / 2 - (0.2 if size.width < 2 else 0.0)
    loaded = rng.random() < 0.4
    top = size.height - (0.25 if loaded else 0.0)
    boards = WOOD if rng.random() < 0.4 else RIM
    reach, middle, tall = (front - back) / 2, (front + back) / 2, (top - floor) / 2
    side = box((middle, half, floor + tall), (reach, 0.02, tall), boards)
    ends = np.array([(front, 0, floor + tall), (back + 0.02, 0, floor + tall)])
    parts = [
        box((middle, 0, floor), (reach, half, 0.04), STEEL),
        both_sides(side),
        boxes(ends, np.tile((0.02, half, tall), (2, 1)), boards),
        *_running_gear(rng, size, 0.29, bar, 1 if size.length < 3 else 2),
    ]
    if loaded:
        tall = (size.height - floor) / 2
        heap = (0.85 * reach, 0.9 * half, tall)
        parts.append(superellipsoid((middle, 0, floor + tall), heap, _TWIGS, exponents=(0.8, 0.6)))
    return parts


def _covered_trailer(rng: np.random.Generator, size: Size) -> list[Mesh]:
    """Build a trailer with a tarpaulin, or of plywood: for luggage, horses or goods."""
    bar, low, axles = 0.26 * size.length, 0.48, 1 if size.length < 2.6 else 2
    tarpaulin = size.height < 2.2 or rng.random() < 0.3
    cover = _livery(rng, Material.CLOTH if tarpaulin else Material.PLASTIC)
    length, board = size.length - bar, low + 0.35
    half = size.width / 2 - 0.19
    panels = [
        *(Panel(face, -9, 9, low, board, RIM) for face in Face),
        *(Panel(face, -9, 9, board, board + 0.02, GAP) for face in Face),
        Panel(Face.REAR, half - 0.06, half - 0.04, low, size.height - 0.1, GAP),
    ]
    if not tarpaulin:
        panels.append(Panel(Face.FRONT, 0, 0.6 * half, 1.5, size.height - 0.4, TINTED_GLASS))
    work = Coachwork(
        length=length,
        width=2 * half,
        low=low,
        high=size.height - 0.05,
        corner=0.06,
        crown=float(rng.uniform(0.03, 0.14)),
        profile=((low, 0.0, 0.0), (size.height - 0.3, 0.0, 0.0), (size.height, 0.12, 0.05)),
    )
    shell = moved(coachwork_mesh(work, cover, panels), (-bar / 2, 0, 0))
    return [shell, *_running_gear(rng, size, 0.29, bar, axles)]


def _caravan(rng: np.random.Generator, size: Size) -> list[Mesh]:
    bar, low = 1.05, 0.42
    sill, top, half = 1.25, 1.95, size.width / 2 - 0.03
    length = size.length - bar
    stripe = _livery(rng, Material.CAR_PAINT)
    places = (length * -0.30, length * 0.02, length * 0.30)
    panels = [
        Panel(Face.SIDES, -9, 9, 0.95, 1.08, stripe),
        *(Panel(Face.SIDES, x - 0.42, x + 0.42, sill, top, TINTED_GLASS) for x in places),
        *(Panel(face, 0, 0.75 * half, sill, top, TINTED_GLASS) for face in (Face.FRONT, Face.REAR)),
        Panel(Face.REAR, 0.82 * half, 0.92 * half, 0.7, 1.1, TAIL_LIGHT),
    ]
    work = Coachwork(
        length=length,
        width=2 * half,
        low=low,
        high=size.height - 0.06,
        corner=0.22,
        crown=0.06,
        profile=(
            (low, 0.25, 0.02),
            (0.9, 0.0, 0.0),
            (sill, 0.04, 0.0),
            (top, 0.22, 0.02),
            (size.height, 0.50, 0.10),
        ),
        rear_leans=True,
    )
    shell = moved(coachwork_mesh(work, _WHITE, panels), (-bar / 2, 0, 0))
    center = (-bar / 2 - 0.05, half + 0.004, 0.33)
    arch = disc(center, (0, 1, 0), 0.42, BLACK_PLASTIC)
    bottle = superellipsoid(
        (size.length / 2 - 0.7, 0, 0.72), (0.28, 0.5, 0.24), _WHITE, exponents=(0.4, 0.4)
    )
    return [shell, both_sides(arch), bottle, *_running_gear(rng, size, 0.31, bar, 1)]


def _semitrailer(rng: np.random.Generator, size: Size) -> list[Mesh]:
    """Build a parked semitrailer on its legs."""
    front = size.length / 2
    leg = box((front - 2.4, 0.9, 0.5), (0.07, 0.07, 0.5), STEEL)
    cargo = _livery(rng, Material.PLASTIC)
    return [both_sides(leg), *semitrailer(rng, size, front, -front, cargo)]


def motorcycle_parts(rng: np.random.Generator, size: Size) -> list[Mesh]:
    """Build a motorcycle over the origin, with the front wheel ahead."""
    paint, radius = _livery(rng, Material.CAR_PAINT), float(rng.uniform(0.26, 0.32))
    front, rear, grips = size.length / 2 - radius, radius - size.length / 2, size.width / 2
    steering = [(front, 0.09, radius), (front - 0.22, 0.09, 0.85), (front - 0.30, 0.05, 1.02)]
    bar = [(front - 0.30, 0, 1.02), (front - 0.32, 0.22, 1.06), (front - 0.42, grips, 1.02)]
    exhaust = [(0.1, -0.16, 0.30), (rear - 0.1, -0.17, 0.38)]
    lumps = (
        ((0.12, 0, 0.80), (0.30, 0.15, 0.16), paint),  # tank
        ((-0.30, 0, 0.78), (0.42, 0.14, 0.09), _LEATHER),
        ((0.05, 0, 0.45), (0.28, 0.18, 0.20), STEEL),  # engine
        ((rear - 0.02, 0, 0.70), (0.28, 0.11, 0.07), paint),
        ((front - 0.12, 0, 0.90), (0.09, 0.10, 0.10), LAMP_GLASS),
    )
    return [
        wheels(wheel(rng, radius, 0.07, rim=RIM), (front, rear), 0.03, radius),
        both_sides(
            tube(steering, 0.025, CHROME, num_sides=6),
            tube(bar, 0.018, BLACK_PLASTIC, num_sides=6),
            tube([(rear, 0.10, radius), (-0.1, 0.10, 0.42)], 0.03, STEEL, num_sides=6),
            box((front - 0.32, grips - 0.08, 1.13), (0.01, 0.06, 0.04), BLACK_PLASTIC),
        ),
        tube(exhaust, (0.03, 0.05), CHROME),
        *(superellipsoid(*lump, exponents=(0.7, 0.7), num_rings=9) for lump in lumps),
        box((rear - 0.28, 0, 0.68), (0.02, 0.07, 0.03), TAIL_LIGHT),
        box((rear - 0.27, 0, 0.52), (0.006, 0.10, 0.09), _WHITE),
    ]


MISC_KINDS: Final = {
    "motorcycle": MiscKind(0.28, Size(1.90, 0.64, 1.39), Size(0.27, 0.15, 0.22), motorcycle_parts),
    "open trailer": MiscKind(0.17, Size(2.48, 1.62, 1.05), Size(0.25, 0.35, 0.19), _open_trailer),
    "covered trailer": MiscKind(
        0.20, Size(2.05, 1.36, 1.80), Size(0.35, 0.15, 0.25), _covered_trailer
    ),
    "horse box": MiscKind(0.12, Size(2.80, 1.90, 2.52), Size(0.60, 0.20, 0.25), _covered_trailer),
    "caravan": MiscKind(0.11, Size(5.49, 2.11, 2.65), Size(0.27, 0.14, 0.20), _caravan),
    "flat trailer": MiscKind(0.04, Size(5.82, 2.39, 0.93), Size(0.30, 0.10, 0.08), _open_trailer),
    "semitrailer": MiscKind(0.08, Size(12.1, 2.62, 3.68), Size(0.46, 0.05, 0.21), _semitrailer),
}
"""Kinds by name; shares, like sizes, are those of KITTI's labels and sum to 1."""

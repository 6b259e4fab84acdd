"""Lorries: box and flatbed on one chassis, and tractors with a trailer."""

from collections.abc import Sequence

import numpy as np

from sightline.simulation.materials import Material
from sightline.simulation.meshes.body import BLACK_PLASTIC, GAP, TAIL_LIGHT, TINTED_GLASS
from sightline.simulation.meshes.car_parts import (
    CHROME,
    LAMP_GLASS,
    ORANGE_LAMP,
    plate,
    wheel,
    wheels,
)
from sightline.simulation.meshes.coachwork import Coachwork, Face, Panel, coachwork_mesh
from sightline.simulation.meshes.edits import both_sides, fitted
from sightline.simulation.meshes.models import ActorModel, RigidShape
from sightline.simulation.meshes.primitives import Finish, box, boxes, disc, moved, superellipsoid
from sightline.simulation.meshes.sizes import KITTI_SIZES, Size
from sightline.simulation.scene import Mesh

STEEL = Finish(Material.METAL, (0.05, 0.05, 0.052))
RIM = Finish(Material.METAL, (0.22, 0.22, 0.23))
_MARKING = Finish(Material.RETRO_REFLECTOR, (0.75, 0.12, 0.02))
WOOD = Finish(Material.WOOD, (0.22, 0.14, 0.08))
LIVERIES = (
    (0.66, 0.66, 0.65), (0.62, 0.62, 0.60), (0.40, 0.02, 0.02), (0.03, 0.08, 0.30),
    (0.05, 0.20, 0.10), (0.55, 0.38, 0.03), (0.30, 0.31, 0.33), (0.08, 0.22, 0.42),
)  # fmt: skip
_CAB_LENGTH = 2.15  # m
_FRONT_AXLE = -1.30  # m, from the front
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


def _cab(
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
        length=_CAB_LENGTH,
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
    front, back = _CAB_LENGTH / 2, -_CAB_LENGTH / 2
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
    arch_center = (_FRONT_AXLE, half + 0.004, radius)
    arch = disc(arch_center, (0, 1, 0), 1.2 * radius, BLACK_PLASTIC, num_sides=24)
    mirror = box((-0.12, half + 0.01, (sill + top) / 2 + 0.05), (0.05, 0.09, 0.20), BLACK_PLASTIC)
    arm = box((-0.14, half - 0.10, top), (0.03, 0.10, 0.02), BLACK_PLASTIC)
    bars = np.linspace(lamp + 0.24, sill - 0.24, 4)
    centers = np.stack((np.full(4, -0.02), np.zeros(4), bars), axis=1)
    grille = boxes(centers, np.tile((0.02, 0.58 * half, 0.015), (4, 1)), CHROME)
    indicator = box((-0.10, 0.985 * half, lamp + 0.30), (0.06, 0.02, 0.04), ORANGE_LAMP)
    pairs = both_sides(arch, mirror, arm, indicator)
    return [shell, pairs, grille, *plate(rng, 0.0, low + 0.20, 1)]


def _axles(rng: np.random.Generator, size: Size, places: Sequence[float], radius: float) -> Mesh:
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


def _frame(front: float, back: float, radius: float) -> list[Mesh]:
    """Build the two supporting beams between x `back` and `front` [m]."""
    center = np.array([[(front + back) / 2, side * 0.42, 1.35 * radius] for side in (-1, 1)])
    return [boxes(center, np.tile(((front - back) / 2, 0.06, 0.14), (2, 1)), STEEL)]


def _tank(x: float, size: Size, radius: float) -> list[Mesh]:
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
    start = -_CAB_LENGTH - 0.12
    edge = Finish(Material.METAL, (0.45, 0.46, 0.47)) if rng.random() < 0.6 else cargo
    parts = _cab(rng, size, cab, cab_height, radius)
    parts.append(_cargo_box(start, -length, 2.15 * radius, size.height, size.width, cargo, edge))
    parts += _frame(-0.6, -length + 0.1, radius)
    parts.append(_axles(rng, size, (_FRONT_AXLE, -0.74 * length), radius))
    parts += _tank(-0.45 * length, size, radius)
    return parts + rear_end(rng, -length, size, radius)


def _flatbed(rng: np.random.Generator, size: Size, cab: Finish) -> list[Mesh]:
    length, radius = size.length, min(0.47, 0.15 * size.height)
    start, floor = -_CAB_LENGTH - 0.15, 2.2 * radius
    half, middle, reach = size.width / 2, (start - length) / 2, (length + start) / 2
    parts = _cab(rng, size, cab, size.height, radius)
    parts += _frame(-0.6, -length + 0.1, radius)
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
    parts.append(_axles(rng, size, (_FRONT_AXLE, -0.76 * length), radius))
    parts += _tank(-0.45 * length, size, radius)
    return parts + rear_end(rng, -length, size, radius)


def _articulated(rng: np.random.Generator, size: Size, cab: Finish, cargo: Finish) -> list[Mesh]:
    radius = 0.48
    return [
        *_cab(rng, size, cab, min(size.height - 0.05, 3.4), radius),
        *_frame(-0.6, -5.4, radius),
        _axles(rng, size, (_FRONT_AXLE, -4.6), radius),
        *_tank(-2.9, size, radius),
        *semitrailer(rng, size, -_CAB_LENGTH - 0.45, -size.length, cargo),
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
        _axles(rng, size, axles, radius),
        *rear_end(rng, back, size, radius),
    ]

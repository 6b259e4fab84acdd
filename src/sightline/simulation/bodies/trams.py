"""Trams of one car or several, with joints between them."""

from itertools import pairwise

import numpy as np

from sightline.simulation.bodies.body import BLACK_PLASTIC, GAP, TAIL_LIGHT, TINTED_GLASS
from sightline.simulation.bodies.car_parts import LAMP_GLASS
from sightline.simulation.bodies.coachwork import Coachwork, Face, Panel, coachwork_mesh
from sightline.simulation.bodies.models import KITTI_SIZES, ActorModel, RigidShape, Size
from sightline.simulation.scene import Material, Mesh, Pose
from sightline.simulation.shapes.edits import both_sides, fitted
from sightline.simulation.shapes.primitives import Color, Finish, box, boxes, moved, tube

_ROOF = Finish(Material.METAL, (0.20, 0.20, 0.21))
_LIVERIES: tuple[tuple[Color, Color], ...] = (  # walls, band below the windows
    ((0.62, 0.50, 0.06), (0.40, 0.02, 0.02)), ((0.55, 0.02, 0.02), (0.62, 0.62, 0.60)),
    ((0.62, 0.62, 0.60), (0.03, 0.10, 0.38)), ((0.58, 0.56, 0.48), (0.05, 0.20, 0.10)),
)  # fmt: skip
_SHORTEST = 11.0  # minimum length [m]
_MODULE_LENGTH = 9.0  # m, roughly
_PANTOGRAPH_ROOM = 0.28  # m


def make_tram(rng: np.random.Generator) -> ActorModel:
    """Draw a tram of KITTI's sizes, at least one car long: shorter labels are truncated trams."""
    length, width, height = KITTI_SIZES["Tram"].draw(rng, 1)[0].tolist()
    if length < _SHORTEST:
        length = float(rng.uniform(_SHORTEST, 15.0))
    size = Size(length, width, height)
    wall, band = (
        Finish(Material.CAR_PAINT, color) for color in _LIVERIES[int(rng.integers(len(_LIVERIES)))]
    )
    count = max(1, round(size.length / _MODULE_LENGTH))
    parts = []
    for index in range(count):
        parts += _module(size, count, index, wall, band)
    parts += _roof_gear(size, count)
    mesh = fitted(Mesh.joined(parts), size)
    return ActorModel(class_name="Tram", size_lwh=size, shape=RigidShape(mesh=mesh))


def _module(size: Size, count: int, index: int, wall: Finish, band: Finish) -> list[Mesh]:
    """Build one car of the tram; the first and last have a driver's front."""
    step = size.length / count
    start, end = size.length / 2 - index * step, size.length / 2 - (index + 1) * step
    joint = 0.22
    first, last = index == 0, index == count - 1
    start, end = start - (0 if first else joint), end + (0 if last else joint)
    length, high = start - end, size.height - _PANTOGRAPH_ROOM
    has_end = first or last
    work = Coachwork(
        length=length,
        width=size.width,
        low=0.22,
        high=high,
        corner=0.30 if has_end else 0.06,
        crown=0.08,
        profile=_end_profile(high)
        if has_end
        else ((0.22, 0.0, 0.02), (0.6, 0.0, 0.0), (1.2, 0.0, 0.0), (high, 0.0, 0.16)),
        rear_leans=count == 1,
    )
    panels = _side_panels(length, high, band)
    if has_end:
        faces = [Face.FRONT, *([Face.REAR] if count == 1 else [])]
        for face in faces:
            panels += _end_panels(
                face,
                size.width / 2,
                high,
                TAIL_LIGHT if face is Face.REAR or not first else LAMP_GLASS,
            )
    mesh = coachwork_mesh(work, wall, panels)
    if last and not first:  # its driver's front faces backwards
        mesh = mesh.placed(Pose(x=0.0, y=0.0, z=0.0, yaw=np.pi))
    parts = [moved(mesh, ((start + end) / 2, 0, 0))]
    if not last:
        center, half = (
            (end - joint, 0, 0.3 + (high - 0.4) / 2),
            (joint + 0.02, 0.44 * size.width, (high - 0.4) / 2),
        )
        parts.append(box(center, half, BLACK_PLASTIC))
    bogies = [0.5 * (start + end) + side * min(0.3 * length, 3.0) for side in (-1, 1)]
    centers = np.array([(x, 0, 0.2) for x in bogies])
    return [*parts, boxes(centers, np.tile((0.9, 0.40 * size.width, 0.2), (2, 1)), BLACK_PLASTIC)]


def _end_profile(high: float) -> tuple[tuple[float, float, float], ...]:
    return (
        (0.22, 0.10, 0.03),
        (0.55, 0.0, 0.0),
        (1.20, 0.08, 0.0),
        (0.86 * high, 0.48, 0.10),
        (high, 0.75, 0.18),
    )


def _side_panels(length: float, high: float, band: Finish) -> list[Panel]:
    """Build skirt, coloured band, a row of windows and doors."""
    reach, low, top = length / 2, 1.05, 0.80 * high
    panels = [
        Panel(Face.SIDES, -reach, reach, 0, 0.45, BLACK_PLASTIC),
        Panel(Face.SIDES, -reach, reach, 0.72, 0.95, band),
        Panel(Face.SIDES, -reach + 0.7, reach - 0.7, low - 0.06, top + 0.06, BLACK_PLASTIC),
    ]
    count = max(3, round((length - 1.6) / 1.35))
    edges = np.linspace(-reach + 0.8, reach - 0.8, count + 1)
    for index, (start, end) in enumerate(pairwise(edges.tolist())):
        door = index % 3 == 1
        bottom = 0.54 if door else low
        if door:
            panels.append(Panel(Face.SIDES, start, end, 0.40, top + 0.06, BLACK_PLASTIC))
        leaves = ((start + 0.05, (start + end) / 2 - 0.03), ((start + end) / 2 + 0.03, end - 0.05))
        for first, last in leaves if door else ((start + 0.04, end - 0.04),):
            panels.append(Panel(Face.SIDES, first, last, bottom, top, TINTED_GLASS))
    return panels


def _end_panels(face: Face, half_width: float, high: float, lamp: Finish) -> list[Panel]:
    top = 0.84 * high
    return [
        Panel(face, 0, half_width, 0, 0.42, BLACK_PLASTIC),
        Panel(face, 0, half_width, 1.15, 0.93 * high, BLACK_PLASTIC),
        Panel(face, 0, half_width - 0.34, 1.22, top, TINTED_GLASS),
        Panel(face, 0, 0.55, top + 0.03, 0.92 * high, Finish(Material.PLASTIC, (0.35, 0.25, 0.02))),
        Panel(face, half_width - 0.62, half_width - 0.36, 0.62, 0.78, lamp),
        Panel(face, half_width - 0.36, half_width - 0.345, 0.62, 0.78, GAP),
    ]


def _roof_gear(size: Size, count: int) -> list[Mesh]:
    """Build boxes on the roof and a lowered pantograph."""
    base = size.height - _PANTOGRAPH_ROOM
    step = size.length / count
    middles = size.length / 2 - step * (np.arange(count) + 0.5)
    centers = np.stack((middles, np.zeros(count), np.full(count, base + 0.12)), axis=1)
    parts = [boxes(centers, np.tile((0.24 * step, 0.30 * size.width, 0.10), (count, 1)), _ROOF)]
    x = float(middles[count // 2])
    top = base + _PANTOGRAPH_ROOM - 0.02
    arm = tube([(x - 0.5, 0.3, base + 0.16), (x + 0.5, 0.45, top)], 0.02, _ROOF, num_sides=5)
    bow = tube([(x + 0.5, -0.75, top), (x + 0.5, 0.75, top)], 0.02, _ROOF, num_sides=5)
    return [*parts, both_sides(arm), bow]

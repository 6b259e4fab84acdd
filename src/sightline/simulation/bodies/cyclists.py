"""Cyclists with a pedalling motion."""

from dataclasses import dataclass, replace
from functools import cache
from typing import Final

import numpy as np
from jaxtyping import Float64

from sightline.simulation.arrays import Bones, Vector3
from sightline.simulation.bodies.figure import Figure, Hair, Legwear, Luggage, make_figure
from sightline.simulation.bodies.models import ActorModel
from sightline.simulation.bodies.people import draw_build, draw_outfit
from sightline.simulation.bodies.skeleton import (
    LEFT,
    RIGHT,
    Bone,
    Limbs,
    Pose,
    Turn,
    bone_transforms,
    reach,
    turn_matrices,
)
from sightline.simulation.scene import Material, Mesh
from sightline.simulation.shapes.edits import mirrored, turned
from sightline.simulation.shapes.primitives import (
    Color,
    Finish,
    box,
    boxes,
    disc,
    moved,
    rods,
    superellipsoid,
    torus,
    tube,
)

# The bicycle's frame: origin on the ground below the bottom bracket; (x, y, z) [m].
_WHEEL_RADIUS = 0.34
_REAR_HUB = (-0.45, 0.0, _WHEEL_RADIUS)
_BRACKET = (0.0, 0.0, 0.29)
_CRANK = 0.17
_PEDAL_Y = 0.125
_HEAD_LOW = (0.475, 0.0, 0.68)
_HEAD_HIGH = (0.435, 0.0, 0.87)
_GEAR_M = 4.6  # distance per turn of the cranks
_RUBBER = Finish(Material.RUBBER, (0.02, 0.02, 0.02))
_STEEL = Finish(Material.METAL, (0.35, 0.35, 0.36))
_BLACK = Finish(Material.PLASTIC, (0.02, 0.02, 0.02))
_REFLECTOR = Finish(Material.RETRO_REFLECTOR, (0.5, 0.02, 0.01))
_LAMP = Finish(Material.HEADLIGHT, (0.8, 0.8, 0.8))
_FRAME_COLORS: tuple[Color, ...] = (
    (0.02, 0.02, 0.022), (0.30, 0.31, 0.32), (0.30, 0.02, 0.02), (0.02, 0.05, 0.20),
    (0.04, 0.14, 0.07), (0.55, 0.55, 0.53), (0.08, 0.25, 0.35),
)  # fmt: skip
_TURNS = np.arange(4) * (np.pi / 2)  # positions of the cranks at which the extent is measured
_FOOT_PITCH = -0.12  # rad


@dataclass(frozen=True, kw_only=True, slots=True)
class Bicycle:
    """Moving parts of a bicycle, each about its own axle."""

    frame: Mesh
    front_hub: tuple[float, float, float]
    wheel: Mesh
    crank: Mesh  # both cranks and the chain wheel; the left crank points up
    pedal: Mesh
    saddle: tuple[float, float]  # x and height [m] of the rider's hips above the saddle
    grips: tuple[float, float, float]  # x, half the distance and height [m] of the hands


@dataclass(frozen=True, kw_only=True, slots=True)
class PedallingCyclist:
    """Cyclist riding in place; the wheels roll correctly if the actor moves at its speed."""

    bicycle: Bicycle
    rider: Figure
    lean: float  # forward lean of the back [rad]
    speed_mps: float
    start: float  # angle of the cranks at time 0 [rad]
    offset: tuple[float, float, float]
    """Shift that centres the box around a whole turn of the cranks over the origin [m]."""

    def at(self, time_s: float) -> Mesh:
        """Build the mesh at a time [s]."""
        way = self.speed_mps * time_s
        return moved(self.turned_to(self.start + 2 * np.pi * way / _GEAR_M, way), self.offset)

    def turned_to(self, crank: float, way_m: float) -> Mesh:
        """Build the mesh for a crank angle and wheels rolled `way_m`, frame's origin."""
        bicycle = self.bicycle
        wheel = turned(bicycle.wheel, _forward_roll(way_m / _WHEEL_RADIUS))
        cranks = turned(bicycle.crank, _forward_roll(crank))
        parts = [bicycle.frame, moved(cranks, _BRACKET)]
        parts += [moved(wheel, hub) for hub in (_REAR_HUB, bicycle.front_hub)]
        parts += [moved(bicycle.pedal, _pedal_place(crank, side)) for side in (1, -1)]
        transforms, shift = self._rider_transforms(crank)
        return Mesh.joined([*parts, moved(self.rider.skinned.bent(transforms), shift)])

    def extent(self) -> tuple[Vector3, Vector3]:
        """Corners [m] of the upright box around a whole turn of the cranks, frame's origin."""
        rolling = _WHEEL_RADIUS * np.array((1.0, 0.0, 1.0))
        wheels = np.array((_REAR_HUB - rolling, self.bicycle.front_hub + rolling))
        turns = _TURNS.tolist()
        pedals = np.array([_pedal_place(turn, side) for turn in turns for side in (1, -1)])
        corners: list[np.ndarray] = [self.bicycle.frame.vertices, wheels, pedals]
        for turn in turns:
            transforms, shift = self._rider_transforms(turn)
            corners.append(self.rider.skinned.bent_vertices(transforms) + shift)
        together = np.vstack(corners)
        return together.min(axis=0), together.max(axis=0)

    def _rider_transforms(self, crank: float) -> tuple[Bones, Vector3]:
        """Compute bone transforms and a shift for a rider on the saddle, pedals and handlebar."""
        joints = self.rider.joints
        pose: Pose = {
            Bone.PELVIS: Turn(forward=-0.45 * self.lean),
            Bone.TORSO: Turn(forward=-0.55 * self.lean),
            Bone.HEAD: Turn(forward=0.75 * self.lean),
        }
        resting = bone_transforms(pose, joints)
        hips = _moved_joint(resting, joints, Bone.LEFT_THIGH)
        shift = np.array((self.bicycle.saddle[0] - hips[0], 0.0, self.bicycle.saddle[1] - hips[2]))
        for limbs in (LEFT, RIGHT):
            pose |= self._leg(crank, limbs)
            pose |= self._arm(resting, shift, limbs)
        return bone_transforms(pose, joints), shift

    def _leg(self, crank: float, limbs: Limbs) -> Pose:
        joints = self.rider.joints
        thigh, shin, foot = limbs.thigh, limbs.shin, limbs.foot
        scale = joints[foot][2] / 0.08
        pedal = _pedal_place(crank, limbs.side)
        ankle_x, ankle_z = pedal[0] - 0.10 * scale, pedal[2] + 0.025 + 0.092 * scale
        upper, lower = joints[thigh][2] - joints[shin][2], joints[shin][2] - joints[foot][2]
        way = reach(
            ankle_x - self.bicycle.saddle[0], ankle_z - self.bicycle.saddle[1], upper, lower
        )
        hip, knee = way.toward + way.opening, way.bend
        pelvis = -0.45 * self.lean
        return {
            thigh: Turn(forward=hip - pelvis),
            shin: Turn(forward=-knee),
            foot: Turn(forward=_FOOT_PITCH - hip + knee),
        }

    def _arm(self, resting: Bones, shift: Vector3, limbs: Limbs) -> Pose:
        joints = self.rider.joints
        arm, forearm, side = limbs.arm, limbs.forearm, limbs.side
        shoulder = _moved_joint(resting, joints, arm) + shift
        x, y, z = self.bicycle.grips
        upper = joints[arm][2] - joints[forearm][2]
        lower = 0.31 / 0.28 * upper
        ahead, above, aside = x - shoulder[0], z - shoulder[2], y - abs(shoulder[1])
        way = reach(float(ahead), float(above), upper, lower)
        spread = side * float(np.arctan2(aside, np.hypot(ahead, above)))
        swing = way.toward + self.lean
        return {
            arm: Turn(
                forward=swing - way.opening,
                left=spread * float(np.cos(swing)) + 0.08 * side,
                twist=spread * float(np.sin(swing)),
            ),
            forearm: Turn(forward=way.bend, left=-0.08 * side),
        }


def make_cyclist(rng: np.random.Generator, speed_mps: float) -> ActorModel:
    """Draw a cyclist who rides at `speed_mps`."""
    build = draw_build(rng)
    build = replace(build, height=float(np.clip(build.height - 0.09, 1.50, 1.90)))
    outfit = draw_outfit(rng)
    outfit = replace(
        outfit,
        hair_style=Hair.HELMET if rng.random() < 0.4 else outfit.hair_style,
        legwear=Legwear.TROUSERS if outfit.legwear is Legwear.SKIRT else outfit.legwear,
        luggage=Luggage.BACKPACK if rng.random() < 0.3 else Luggage.NOTHING,
        hem=max(outfit.hem, 0.9),
    )
    lean = float(rng.uniform(0.25, 0.75))
    cyclist = PedallingCyclist(
        bicycle=_bicycle(rng, build.height / 1.75, lean),
        rider=make_figure(build, outfit),
        lean=lean,
        speed_mps=speed_mps,
        start=float(rng.uniform(0, 2 * np.pi)),
        offset=(0.0, 0.0, 0.0),
    )
    low, high = cyclist.extent()
    middle = (low + high) / 2
    cyclist = replace(cyclist, offset=(-float(middle[0]), -float(middle[1]), -float(low[2])))
    length, width, height = (high - low).tolist()
    return ActorModel(class_name="Cyclist", size_lwh=(length, width, height), shape=cyclist)


_PARKED_LEAN: Final = 0.09  # rad, towards the kickstand


def make_parked_bicycle(rng: np.random.Generator) -> Mesh:
    """Draw a bicycle without a rider, leaning on its stand, with the origin between its wheels."""
    bicycle = _bicycle(rng, float(rng.uniform(0.9, 1.08)), float(rng.uniform(0.25, 0.7)))
    crank = float(rng.uniform(0, 2 * np.pi))
    cranks = turned(bicycle.crank, _forward_roll(crank))
    mesh = Mesh.joined(
        [
            bicycle.frame,
            moved(cranks, _BRACKET),
            *(moved(bicycle.wheel, hub) for hub in (_REAR_HUB, bicycle.front_hub)),
            *(moved(bicycle.pedal, _pedal_place(crank, side)) for side in (1, -1)),
            tube([(-0.1, 0.0, 0.27), (-0.16, 0.14, 0.0)], 0.009, _STEEL, num_sides=5),
        ]
    )
    leaning = turn_matrices(np.array([Turn(left=_PARKED_LEAN)]))[0]
    middle = (_REAR_HUB[0] + bicycle.front_hub[0]) / 2
    return turned(moved(mesh, (-middle, 0.0, 0.0)), leaning)


def _moved_joint(
    transforms: Bones, joints: Float64[np.ndarray, "num_bones 3"], bone: Bone
) -> Vector3:
    return np.asarray(transforms[bone, :, :3] @ joints[bone] + transforms[bone, :, 3])


def _forward_roll(angle: float) -> Float64[np.ndarray, "3 3"]:
    """Compute the rotation of a rolling wheel: its top moves forward."""
    return np.asarray(turn_matrices(np.array([Turn(forward=-angle)]))[0])


def _pedal_place(crank: float, side: int) -> tuple[float, float, float]:
    """Compute the position of a pedal [m]; the left one is on top at angle 0."""
    angle = crank if side > 0 else crank + np.pi
    x, z = _CRANK * float(np.sin(angle)), _CRANK * float(np.cos(angle))
    return _BRACKET[0] + x, side * _PEDAL_Y, _BRACKET[2] + z


def _bicycle(rng: np.random.Generator, scale: float, lean: float) -> Bicycle:
    """Build a bicycle for a rider of `scale` * 1.75 m with this forward lean."""
    hips = _BRACKET[2] - _CRANK + 0.11 + 0.955 * 0.83 * scale
    saddle_x, saddle_z = -0.19, hips - 0.085 * scale
    grip_z = float(np.interp(lean, (0.25, 0.75), (1.08, 0.92))) + 0.25 * (scale - 1)
    grips = (
        float(np.interp(lean, (0.25, 0.75), (0.30, 0.46))),
        float(rng.uniform(0.21, 0.28)),
        grip_z,
    )
    front_hub = (float(rng.uniform(0.56, 0.68)), 0.0, _WHEEL_RADIUS)
    paint = Finish(Material.CAR_PAINT, _FRAME_COLORS[int(rng.integers(len(_FRAME_COLORS)))])
    frame = _frame(paint, (saddle_x - 0.01, saddle_z - 0.05), grips, front_hub)
    frame += _equipment(rng, (saddle_x, saddle_z), front_hub)
    return Bicycle(
        frame=Mesh.joined(frame),
        front_hub=front_hub,
        wheel=_wheel(),
        crank=_cranks(),
        pedal=box((0, 0, 0), (0.045, 0.045, 0.010), _BLACK),
        saddle=(saddle_x, hips),
        grips=grips,
    )


def _frame(
    paint: Finish,
    seat: tuple[float, float],
    grips: tuple[float, float, float],
    front_hub: tuple[float, float, float],
) -> list[Mesh]:
    """Build frame, fork, handlebar and saddle post."""
    seat_tube = (-0.15, 0.0, 0.76)
    lines = (
        (_BRACKET, seat_tube, 0.017),
        (_BRACKET, _HEAD_LOW, 0.020),
        (seat_tube, _HEAD_HIGH, 0.016),
        (_HEAD_LOW, _HEAD_HIGH, 0.021),
        *(
            ((end[0], side * width, end[2]), (_REAR_HUB[0], side * 0.055, _REAR_HUB[2]), 0.009)
            for end, width in ((_BRACKET, 0.03), (seat_tube, 0.02))
            for side in (1, -1)
        ),
    )
    starts, ends, radii = zip(*lines, strict=True)
    parts = [rods(starts, ends, radii, paint)]
    bow = (0.45 * front_hub[0] + 0.26, 0.05, 0.52)
    blade_path = [(0.475, 0.03, 0.68), bow, (front_hub[0], 0.05, front_hub[2])]
    blade = tube(blade_path, 0.012, paint, num_sides=6)
    parts += [blade, mirrored(blade)]
    stem_z = grips[2] - 0.01
    stem = [_HEAD_HIGH, (0.42, 0.0, stem_z - 0.02), (0.44, 0.0, stem_z)]
    parts.append(tube(stem, 0.014, _STEEL, num_sides=6))
    bar = [(0.44, 0.0, stem_z), (0.445, 0.12, stem_z), (grips[0] + 0.03, grips[1] - 0.04, grips[2])]
    bar_half = tube(bar, 0.012, _STEEL, num_sides=6)
    grip = tube(
        [bar[-1], (grips[0] - 0.02, grips[1] + 0.05, grips[2] - 0.01)], 0.017, _BLACK, num_sides=6
    )
    parts += [bar_half, mirrored(bar_half), grip, mirrored(grip)]
    post = [seat_tube, (seat[0], 0.0, seat[1])]
    parts.append(tube(post, 0.013, _STEEL, num_sides=6))
    return parts


def _equipment(
    rng: np.random.Generator, saddle: tuple[float, float], front_hub: tuple[float, float, float]
) -> list[Mesh]:
    """Build saddle, lamps, mudguards; a carrier, sometimes with a basket."""
    x, z = saddle
    seat = (x + 0.02, 0.0, z - 0.03)
    parts = [
        superellipsoid(seat, (0.135, 0.075, 0.035), _BLACK, num_rings=6, num_sides=10),
        box((_REAR_HUB[0] - 0.33, 0, 0.58), (0.012, 0.035, 0.035), _REFLECTOR),
        superellipsoid((0.50, 0, 0.80), (0.035, 0.035, 0.035), _LAMP, num_rings=5, num_sides=8),
    ]
    angles = np.linspace(-0.2, 2.3, 9)
    radius = _WHEEL_RADIUS + 0.025
    if rng.random() < 0.7:
        for hub, sign in ((_REAR_HUB, 1.0), (front_hub, 0.8)):
            path = np.stack(
                (
                    hub[0] - radius * np.cos(angles * sign),
                    np.zeros(9),
                    hub[2] + radius * np.sin(angles * sign),
                ),
                axis=1,
            )
            parts.append(tube(path, 0.018, _BLACK, num_sides=5))
    if rng.random() < 0.6:
        rails = np.array([(-0.52, side * 0.06, 0.74) for side in (-1, 1)])
        parts.append(boxes(rails, np.tile((0.19, 0.006, 0.006), (2, 1)), _STEEL))
        low, high = (
            [(x, side, z) for side in (-0.06, 0.06)] for x, z in ((-0.45, 0.34), (-0.55, 0.74))
        )
        parts.append(rods(low, high, 0.006, _STEEL, num_sides=5))
        if rng.random() < 0.35:
            parts.append(box((-0.53, 0, 0.86), (0.15, 0.13, 0.11), _BLACK))
    return parts


@cache  # all bicycles share it; meshes are never written to
def _wheel() -> Mesh:
    """Build tyre, rim, spokes and hub about the y axis."""
    rim = torus((0, 0, 0), _WHEEL_RADIUS - 0.036, 0.010, _STEEL, num_sides=24, num_tube_sides=5)
    tyre = torus((0, 0, 0), _WHEEL_RADIUS - 0.019, 0.019, _RUBBER, num_sides=24, num_tube_sides=6)
    hub = tube([(0, -0.05, 0), (0, 0.05, 0)], 0.02, _STEEL, num_sides=6)
    angles = np.arange(7) * (np.pi / 7)
    ends = np.stack((np.cos(angles), np.zeros(7), np.sin(angles)), axis=1) * (_WHEEL_RADIUS - 0.04)
    return Mesh.joined([tyre, rim, hub, rods(-ends, ends, 0.0022, _STEEL, num_sides=3)])


@cache
def _cranks() -> Mesh:
    """Build both cranks and the chain wheel about the y axis; the left crank points up."""
    left = tube([(0, 0.07, 0), (0, 0.085, _CRANK)], 0.012, _STEEL, num_sides=5)
    right = tube([(0, -0.07, 0), (0, -0.085, -_CRANK)], 0.012, _STEEL, num_sides=5)
    chain_wheel = [
        disc((0, -0.05, 0), (0, side, 0), 0.09, _STEEL, num_sides=14) for side in (-1, 1)
    ]
    return Mesh.joined([left, right, *chain_wheel])

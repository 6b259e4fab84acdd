"""Standing and walking pedestrians, and sitting people."""

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, replace

import numpy as np

from sightline.simulation.arrays import Vector3
from sightline.simulation.bodies.figure import (
    Build,
    Figure,
    Hair,
    Legwear,
    Luggage,
    Outfit,
    make_figure,
)
from sightline.simulation.bodies.models import KITTI_SIZES, ActorModel, RigidShape
from sightline.simulation.bodies.skeleton import LEFT, RIGHT, Bone, Pose, Turn, bone_transforms
from sightline.simulation.scene import Material, Mesh
from sightline.simulation.shapes.primitives import Color, Finish, boxes, moved, tube

_LEG_LENGTH = 0.90 / 1.75  # share of the height
_WALKING_FROM_MPS = 0.15
_ANNOTATED_STRIDE = 0.90, 0.125  # mean and deviation of a walker's labelled length, in strides
_ANNOTATED_ROOM_M = 0.10, 0.10  # same for a standing person's margin in the label
_ANNOTATED_WIDTH = 1.10, 0.22  # mean and deviation of a label's width, in the person's widths
_LABELS = 21  # separates the random numbers of labels from all others
_PHASES = np.arange(12) * (np.pi / 6)  # phases of a stride for measuring its extent


@dataclass(frozen=True, kw_only=True, slots=True)
class Gait:
    """Gait of a walker."""

    stride_hz: float  # frequency of strides, of two steps each
    swing: float  # amplitude [rad] of the thighs' swing
    start: float  # phase at time 0 [rad]
    arms: float  # relative swing of the arms, 0 to 1


@dataclass(frozen=True, kw_only=True, slots=True)
class WalkingPerson:
    """Person walking in place; no foot slips if the actor moves at its speed."""

    figure: Figure
    gait: Gait
    offset: tuple[float, float]
    """Shift that centres the box around the whole stride over the origin [m]."""

    def at(self, time_s: float) -> Mesh:
        """Build the mesh at a time."""
        phase = self.gait.start + 2 * np.pi * self.gait.stride_hz * time_s
        return _grounded(self.figure, walking_pose(phase, self.gait), self.offset)


def walking_pose(phase: float, gait: Gait) -> Pose:
    """Compute the joint angles in a stride; at phase 0 the left heel strikes, at pi the right one.

    The curves are simple fits to data of gait laboratories: the hip like a cosine, the knee with a
    small bend after the strike and a large one while the leg swings.
    """
    share = gait.swing / 0.42
    pose: Pose = {
        Bone.PELVIS: Turn(twist=-0.10 * share * np.cos(phase)),
        Bone.TORSO: Turn(forward=-0.05 - 0.03 * share, twist=0.20 * share * np.cos(phase)),
        Bone.HEAD: Turn(forward=0.04, twist=-0.10 * share * np.cos(phase)),
    }
    for limbs in (LEFT, RIGHT):
        own = phase if limbs is LEFT else phase + np.pi
        hip = gait.swing * np.cos(own) + 0.05 * share
        knee = 0.06 + 0.25 * _bump(own, 0.30 * np.pi, 0.45)
        knee += 1.05 * _bump(own, 1.40 * np.pi, 0.70)
        sole = 0.30 * _bump(own, 0.0, 0.40) - 0.75 * _bump(own, 1.12 * np.pi, 0.45)
        knee, sole = share * knee, share * sole
        pose[limbs.thigh] = Turn(forward=hip)
        pose[limbs.shin] = Turn(forward=-knee)
        pose[limbs.foot] = Turn(forward=sole - hip + knee)
        swing = -0.75 * gait.swing * gait.arms * np.cos(own)
        pose[limbs.arm] = Turn(forward=swing, left=0.10 * limbs.side)
        pose[limbs.forearm] = Turn(forward=0.18 + 0.5 * max(swing, 0.0))
    return pose


def _bump(phase: float, middle: float, width: float) -> float:
    """Compute a smooth periodic hump of height 1; `width` [rad] is like a standard deviation."""
    return float(np.exp((np.cos(phase - middle) - 1) / width**2))


def make_pedestrian(rng: np.random.Generator, speed_mps: float) -> ActorModel:
    """Draw a pedestrian who walks at `speed_mps`, or stands if it is near 0."""
    build, outfit = draw_build(rng), draw_outfit(rng)
    figure = make_figure(build, outfit)
    if speed_mps < _WALKING_FROM_MPS:
        mesh = _centered(_grounded(figure, _standing_pose(rng), (0.0, 0.0)))
        return _annotated(rng, _model("Pedestrian", mesh, RigidShape(mesh=mesh)), walks=False)
    gait = _gait(rng, build, speed_mps, outfit)
    walking = WalkingPerson(figure=figure, gait=gait, offset=(0.0, 0.0))
    low, high = _extent(figure, [walking_pose(phase, gait) for phase in _PHASES])
    middle = (low + high) / 2
    walking = replace(walking, offset=(-float(middle[0]), -float(middle[1])))
    length, width, height = (high - low).tolist()
    model = ActorModel(class_name="Pedestrian", size_lwh=(length, width, height), shape=walking)
    return _annotated(rng, model, walks=True)


def _annotated(rng: np.random.Generator, model: ActorModel, *, walks: bool) -> ActorModel:
    """Add a label size as by KITTI's annotators: estimated by eye, constant for a person.

    Walkers' boxes hold most of a stride, seldom all of it, and those of standing people have a
    margin, so the lengths match KITTI's 4,487: 0.84 m, deviation 0.23 m. No numbers are drawn from
    `rng` itself, so that streets do not depend on the label sizes.
    """
    length, width, height = model.size_lwh
    ahead = deepcopy(rng.bit_generator).random_raw(2)
    own = np.random.default_rng([_LABELS, *ahead.tolist()])
    if walks:
        length *= own.normal(*_ANNOTATED_STRIDE)
    else:
        length += own.normal(*_ANNOTATED_ROOM_M)
    width *= own.normal(*_ANNOTATED_WIDTH)
    low, high = KITTI_SIZES["Pedestrian"].low, KITTI_SIZES["Pedestrian"].high
    length = float(np.clip(length, low.length, high.length))
    return replace(
        model, labelled_lwh=(length, float(np.clip(width, low.width, high.width)), height)
    )


def _extent(figure: Figure, poses: Sequence[Pose]) -> tuple[Vector3, Vector3]:
    """Compute corners [m] of the upright box around the figure in all these poses on the ground."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for pose in poses:
        bent = figure.skinned.bent_vertices(bone_transforms(pose, figure.joints))
        bent[:, 2] -= bent[:, 2].min()
        low, high = np.minimum(low, bent.min(axis=0)), np.maximum(high, bent.max(axis=0))
    return low, high


def _gait(rng: np.random.Generator, build: Build, speed_mps: float, outfit: Outfit) -> Gait:
    """Draw a gait with the step length of people of this height at this speed."""
    step = 0.62 * np.sqrt(speed_mps) * np.sqrt(build.height / 1.75) * rng.uniform(0.94, 1.06)
    step = float(np.clip(step, 0.2, 0.95 * _LEG_LENGTH * build.height))
    swing = float(np.arcsin(step / (2 * _LEG_LENGTH * build.height)))
    bag = outfit.luggage is Luggage.HANDBAG
    return Gait(
        stride_hz=speed_mps / (2 * step),
        swing=swing,
        start=float(rng.uniform(0, 2 * np.pi)),
        arms=0.35 if bag else float(rng.uniform(0.6, 1.1)),
    )


def _grounded(figure: Figure, pose: Pose, offset: tuple[float, float]) -> Mesh:
    """Bend the figure and put its lowest point on the ground."""
    mesh = figure.skinned.bent(bone_transforms(pose, figure.joints))
    return moved(mesh, (*offset, -float(mesh.vertices[:, 2].min())))


def _centered(mesh: Mesh) -> Mesh:
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    return moved(mesh, (-(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -low[2]))


def _model(class_name: str, mesh: Mesh, shape: RigidShape) -> ActorModel:
    length, width, height = (mesh.vertices.max(axis=0) - mesh.vertices.min(axis=0)).tolist()
    return ActorModel(class_name=class_name, size_lwh=(length, width, height), shape=shape)


def _standing_pose(rng: np.random.Generator) -> Pose:
    """Draw a pose with the weight on one leg, arms hanging, folded or at a telephone."""
    lean, twist, spread = rng.uniform(-0.05, 0.05), rng.uniform(-0.25, 0.25), rng.uniform(0, 0.1)
    pose: Pose = {
        Bone.TORSO: Turn(forward=-0.02, left=lean, twist=twist / 2),
        Bone.HEAD: Turn(forward=float(rng.uniform(-0.15, 0.05)), twist=twist),
        Bone.LEFT_THIGH: Turn(forward=0.10 * lean, left=-spread),
        Bone.RIGHT_THIGH: Turn(forward=float(rng.uniform(0, 0.2)), left=spread),
        Bone.RIGHT_SHIN: Turn(forward=-float(rng.uniform(0, 0.15))),
        Bone.LEFT_ARM: Turn(forward=float(rng.uniform(-0.1, 0.15)), left=0.10),
        Bone.RIGHT_ARM: Turn(forward=float(rng.uniform(-0.1, 0.15)), left=-0.10),
        Bone.LEFT_FOREARM: Turn(forward=float(rng.uniform(0.1, 0.4))),
        Bone.RIGHT_FOREARM: Turn(forward=float(rng.uniform(0.1, 0.4))),
    }
    posture = rng.random()
    if posture < 0.25:  # looks at a telephone
        pose[Bone.RIGHT_ARM] = Turn(forward=0.45, left=0.1)
        pose[Bone.RIGHT_FOREARM] = Turn(forward=1.6, left=0.3)
        pose[Bone.HEAD] = Turn(forward=-0.35)
    elif posture < 0.45:  # hands in the pockets
        pose[Bone.LEFT_ARM] = Turn(forward=-0.25, left=0.28)
        pose[Bone.RIGHT_ARM] = Turn(forward=-0.25, left=-0.28)
        pose[Bone.LEFT_FOREARM] = Turn(forward=0.75, left=-0.5)
        pose[Bone.RIGHT_FOREARM] = Turn(forward=0.75, left=0.5)
    return pose


def make_sitting_person(rng: np.random.Generator) -> ActorModel:
    """Draw a person on a chair, which is part of the shape."""
    build = draw_build(rng)
    build = replace(build, height=float(np.clip(build.height - 0.13, 1.45, 1.80)))
    outfit = draw_outfit(rng)
    legs = Legwear.TROUSERS if outfit.legwear is Legwear.SKIRT else outfit.legwear
    outfit = replace(outfit, luggage=Luggage.NOTHING, hem=0.97, shirt=None, legwear=legs)
    figure = make_figure(build, outfit)
    recline = float(rng.uniform(-0.15, 0.12))
    knees = float(rng.uniform(1.25, 1.6))
    open_legs = float(rng.uniform(0.03, 0.22))
    pose: Pose = {
        Bone.TORSO: Turn(forward=-recline - 0.05),
        Bone.HEAD: Turn(forward=float(rng.uniform(-0.2, 0.1)), twist=float(rng.uniform(-0.5, 0.5))),
    }
    for limbs in (LEFT, RIGHT):
        pose[limbs.thigh] = Turn(forward=1.50, left=open_legs * limbs.side)
        pose[limbs.shin] = Turn(forward=-knees)
        pose[limbs.foot] = Turn(forward=knees - 1.50)
        raised = float(rng.uniform(0.25, 0.5))
        pose[limbs.arm] = Turn(forward=raised, left=0.20 * limbs.side)
        lowered = 1.12 - recline if rng.random() < 0.85 else 1.72 - recline  # lap or table
        pose[limbs.forearm] = Turn(forward=lowered - raised, left=-0.25 * limbs.side)
    mesh = _grounded(figure, pose, (0.0, 0.0))
    seat = 0.405 / 1.75 * build.height
    mesh = _centered(Mesh.joined((mesh, _chair(rng, seat))))
    return _model("Person_sitting", mesh, RigidShape(mesh=mesh))


def _chair(rng: np.random.Generator, seat: float) -> Mesh:
    """Build a simple chair with a seat at the height `seat` [m]."""
    wood = Finish(Material.WOOD, (0.22, 0.13, 0.07))
    steel = Finish(Material.METAL, (0.10, 0.10, 0.11))
    plastic = Finish(Material.PLASTIC, (0.30, 0.31, 0.30))
    finish = (wood, steel, plastic)[int(rng.integers(3))]
    slabs = np.array([(0.03, 0, seat - 0.02), (-0.225, 0, seat + 0.36)])
    halves = np.array([(0.21, 0.21, 0.018), (0.012, 0.20, 0.10)])
    parts = [boxes(slabs, halves, finish)]
    for side in (-0.19, 0.19):
        parts.append(tube([(0.21, side, 0), (0.20, side, seat - 0.02)], 0.014, steel, num_sides=6))
        back = [(-0.24, side, 0), (-0.17, side, seat), (-0.225, side, seat + 0.46)]
        parts.append(tube(back, 0.014, steel, num_sides=6))
    return Mesh.joined(parts)


_SKINS: tuple[Color, ...] = (
    (0.62, 0.42, 0.32), (0.55, 0.35, 0.25), (0.42, 0.26, 0.17), (0.16, 0.09, 0.06),
)  # fmt: skip
_SKIN_SHARES = (0.45, 0.33, 0.14, 0.08)
_HAIRS: tuple[Color, ...] = (
    (0.018, 0.013, 0.010), (0.06, 0.035, 0.02), (0.14, 0.085, 0.04), (0.36, 0.25, 0.12),
    (0.36, 0.35, 0.34),
)  # fmt: skip
_CLOTHS: tuple[Color, ...] = (
    (0.015, 0.015, 0.017), (0.04, 0.042, 0.05), (0.02, 0.03, 0.08), (0.18, 0.18, 0.19),
    (0.55, 0.55, 0.53), (0.30, 0.23, 0.15), (0.33, 0.03, 0.03), (0.05, 0.14, 0.30),
    (0.05, 0.13, 0.06), (0.50, 0.30, 0.05), (0.32, 0.12, 0.20), (0.10, 0.06, 0.035),
)  # fmt: skip
_TROUSERS: tuple[Color, ...] = (
    (0.02, 0.03, 0.07), (0.05, 0.075, 0.15), (0.015, 0.015, 0.017), (0.10, 0.10, 0.105),
    (0.26, 0.21, 0.14), (0.05, 0.035, 0.025),
)  # fmt: skip


def draw_build(rng: np.random.Generator) -> Build:
    """Draw a build: slim, average, heavy or a child's; heights as of KITTI's pedestrians."""
    if rng.random() < 0.03:
        height = float(rng.uniform(1.15, 1.45))
        return Build(height=height, girth=0.92, head=1.35 - 0.25 * (height - 1.1), shoulders=0.92)
    statistics = KITTI_SIZES["Pedestrian"]
    height = float(np.clip(rng.normal(statistics.mean.height, 0.095), 1.50, 1.98))
    girth = float(
        rng.choice(
            [rng.uniform(0.88, 1.0), rng.uniform(1.0, 1.2), rng.uniform(1.2, 1.4)],
            p=[0.5, 0.38, 0.12],
        )
    )
    return Build(
        height=height,
        girth=girth,
        shoulders=float(rng.uniform(0.92, 1.10)),
        hips=float(rng.uniform(0.94, 1.12)),
    )


def draw_outfit(rng: np.random.Generator) -> Outfit:
    """Draw everyday clothes."""
    legwear = Legwear(int(rng.choice(3, p=[0.82, 0.07, 0.11])))
    cold = legwear is Legwear.TROUSERS and rng.random() < 0.6
    hem = float(
        rng.choice(
            [0.97, rng.uniform(0.84, 0.93), rng.uniform(0.55, 0.75)],
            p=[0.12, 0.68, 0.20] if cold else [0.4, 0.6, 0.0],
        )
    )
    return Outfit(
        skin=_shaded(rng, _SKINS[int(rng.choice(4, p=_SKIN_SHARES))]),
        hair=_shaded(rng, _HAIRS[int(rng.integers(len(_HAIRS)))]),
        hair_style=Hair(int(rng.choice(4, p=[0.55, 0.27, 0.06, 0.12]))),
        top=_shaded(rng, _CLOTHS[int(rng.integers(len(_CLOTHS)))]),
        bottom=_shaded(rng, _TROUSERS[int(rng.integers(len(_TROUSERS)))]),
        shoes=_shaded(
            rng,
            ((0.02, 0.02, 0.02), (0.45, 0.45, 0.43), (0.10, 0.06, 0.03))[
                int(rng.choice(3, p=[0.6, 0.2, 0.2]))
            ],
        ),
        accent=_shaded(rng, _CLOTHS[int(rng.integers(len(_CLOTHS)))]),
        short_sleeves=not cold and rng.random() < 0.6,
        legwear=legwear,
        hem=hem,
        shirt=_shaded(rng, _CLOTHS[int(rng.integers(len(_CLOTHS)))])
        if cold and rng.random() < 0.4
        else None,
        luggage=Luggage(int(rng.choice(4, p=[0.58, 0.18, 0.11, 0.13]))),
    )


def _shaded(rng: np.random.Generator, color: Color) -> Color:
    """Make the colour a little lighter or darker."""
    red, green, blue = np.clip(np.array(color) * rng.uniform(0.75, 1.3), 0.0, 0.9).tolist()
    return red, green, blue

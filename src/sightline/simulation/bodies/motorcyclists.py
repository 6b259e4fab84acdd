"""People riding motorcycles; by KITTI's classes, cyclists on two wheels with an engine."""

from dataclasses import replace
from typing import Final

import numpy as np

from sightline.simulation.bodies.figure import Figure, Hair, Legwear, Luggage, make_figure
from sightline.simulation.bodies.models import ActorModel, RigidShape, Size
from sightline.simulation.bodies.people import draw_build, draw_outfit
from sightline.simulation.bodies.skeleton import (
    LEFT,
    RIGHT,
    Bone,
    Pose,
    Turn,
    bone_transforms,
    reach,
)
from sightline.simulation.bodies.trucks import motorcycle_parts
from sightline.simulation.scene import Mesh
from sightline.simulation.shapes.edits import fitted
from sightline.simulation.shapes.primitives import moved

_MEAN: Final = (2.05, 0.78, 1.15)
_DEVIATION: Final = (0.14, 0.06, 0.04)
_HIPS: Final = (-0.28, 0.92)  # x, z [m] of the hips over the middle of the motorcycle
_PEG: Final = (-0.12, 0.38)  # x, z of the ankles
_KNEES_OUT: Final = 0.22  # rad
_FOREARM: Final = 0.31 / 0.28  # length, as a share of the upper arm's


def make_motorcyclist(rng: np.random.Generator) -> ActorModel:
    """Draw a motorcycle with its rider."""
    size = Size(*rng.normal(_MEAN, _DEVIATION).tolist())
    machine = fitted(Mesh.joined(motorcycle_parts(rng, size)), size)
    build = draw_build(rng)
    build = replace(build, height=float(np.clip(build.height - 0.06, 1.55, 1.9)))
    outfit = draw_outfit(rng)
    legs = Legwear.TROUSERS if outfit.legwear is Legwear.SKIRT else outfit.legwear
    outfit = replace(
        outfit, hair_style=Hair.HELMET, legwear=legs, hem=0.97, shirt=None, short_sleeves=False,
        luggage=Luggage.BACKPACK if rng.random() < 0.25 else Luggage.NOTHING,
    )  # fmt: skip
    rider = _seated(make_figure(build, outfit), size, float(rng.uniform(0.1, 0.5)))
    mesh = Mesh.joined([machine, rider])
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    mesh = moved(mesh, (-(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -low[2]))
    length, width, height = (high - low).tolist()
    return ActorModel(
        class_name="Cyclist", size_lwh=(length, width, height), shape=RigidShape(mesh=mesh)
    )


def _seated(figure: Figure, size: Size, lean: float) -> Mesh:
    """Bend a figure onto the saddle, feet on the pegs and hands on the grips."""
    joints = figure.joints
    pose: Pose = {Bone.TORSO: Turn(forward=-lean), Bone.HEAD: Turn(forward=0.7 * lean)}
    resting = bone_transforms(pose, joints)
    hips = joints[Bone.LEFT_THIGH]
    shift = np.array((_HIPS[0] - hips[0], 0.0, _HIPS[1] - hips[2]))
    grips = size.length / 2 - 0.30 - 0.42, 1.02  # as in `motorcycle_parts`
    for limbs in (LEFT, RIGHT):
        upper = joints[limbs.thigh][2] - joints[limbs.shin][2]
        lower = joints[limbs.shin][2] - joints[limbs.foot][2]
        leg = reach(_PEG[0] - _HIPS[0], _PEG[1] - _HIPS[1], upper, lower)
        thigh = leg.toward + leg.opening
        pose[limbs.thigh] = Turn(forward=thigh, left=_KNEES_OUT * limbs.side)
        pose[limbs.shin] = Turn(forward=-leg.bend)
        pose[limbs.foot] = Turn(forward=leg.bend - thigh)
        shoulder = resting[limbs.arm, :, :3] @ joints[limbs.arm] + resting[limbs.arm, :, 3] + shift
        upper = joints[limbs.arm][2] - joints[limbs.forearm][2]
        arm = reach(grips[0] - shoulder[0], grips[1] - shoulder[2], upper, _FOREARM * upper)
        pose[limbs.arm] = Turn(forward=arm.toward + lean - arm.opening, left=0.2 * limbs.side)
        pose[limbs.forearm] = Turn(forward=arm.bend, left=-0.1 * limbs.side)
    return moved(figure.skinned.bent(bone_transforms(pose, joints)), tuple(shift.tolist()))

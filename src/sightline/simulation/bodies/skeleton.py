"""A skeleton that bends a mesh: bones, poses and linear blend skinning.

The resting figure stands upright at the origin with hanging arms and looks along x; z up, metres.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Float64

from sightline.simulation.arrays import Bones
from sightline.simulation.scene import Mesh


class Bone(IntEnum):
    """Bones; each follows its parent, which comes before it."""

    PELVIS = 0
    TORSO = 1
    HEAD = 2
    LEFT_ARM = 3
    LEFT_FOREARM = 4
    RIGHT_ARM = 5
    RIGHT_FOREARM = 6
    LEFT_THIGH = 7
    LEFT_SHIN = 8
    LEFT_FOOT = 9
    RIGHT_THIGH = 10
    RIGHT_SHIN = 11
    RIGHT_FOOT = 12


class Limbs(NamedTuple):
    """The bones of one side."""

    side: int  # 1 left, -1 right
    arm: Bone
    forearm: Bone
    thigh: Bone
    shin: Bone
    foot: Bone


LEFT = Limbs(1, Bone.LEFT_ARM, Bone.LEFT_FOREARM, Bone.LEFT_THIGH, Bone.LEFT_SHIN, Bone.LEFT_FOOT)
RIGHT = Limbs(
    -1, Bone.RIGHT_ARM, Bone.RIGHT_FOREARM, Bone.RIGHT_THIGH, Bone.RIGHT_SHIN, Bone.RIGHT_FOOT
)
_PARENTS = (-1, 0, 1, 1, 3, 1, 5, 0, 7, 8, 0, 10, 11)
REST_JOINTS = np.array([
    (0.0, 0.0, 0.95), (0.0, 0.0, 1.04), (-0.01, 0.0, 1.49), (0.0, 0.185, 1.41), (0.0, 0.205, 1.13),
    (0.0, -0.185, 1.41), (0.0, -0.205, 1.13), (0.0, 0.09, 0.91), (0.0, 0.09, 0.49),
    (0.0, 0.09, 0.08), (0.0, -0.09, 0.91), (0.0, -0.09, 0.49), (0.0, -0.09, 0.08),
])  # fmt: skip
"""Start of each bone [m]."""


class Turn(NamedTuple):
    """Rotation of a bone relative to its parent [rad].

    Positive values swing a hanging limb forward, swing it to the left, twist it counter-clockwise.
    """

    forward: float = 0.0
    left: float = 0.0
    twist: float = 0.0


Pose = dict[Bone, Turn]  # rotations of the bones that are not at rest


@dataclass(frozen=True, kw_only=True, slots=True)
class Skinned:
    """Mesh in the resting pose with the weights of the bones at each vertex."""

    mesh: Mesh
    weights: Float32[np.ndarray, "num_vertices num_bones"]  # rows sum to 1

    @staticmethod
    def joined(parts: Sequence["Skinned"]) -> "Skinned":
        """Join the parts of one figure."""
        return Skinned(
            mesh=Mesh.joined([part.mesh for part in parts]),
            weights=np.concatenate([part.weights for part in parts]),
        )

    def bent_vertices(self, transforms: Bones) -> Float64[np.ndarray, "num_vertices 3"]:
        """Compute the vertices after each bone's transform from the resting pose."""
        return self._moved(self._blended(transforms))

    def bent(self, transforms: Bones) -> Mesh:
        """Compute the mesh after each bone's transform from the resting pose."""
        blended = self._blended(transforms)
        vertices = self._moved(blended)
        normals = np.einsum("vij,vj->vi", blended[:, :, :3], self.mesh.normals)
        lengths = np.sqrt(np.square(normals).sum(axis=1, keepdims=True))
        normals /= np.maximum(lengths, 1e-9)
        return replace(
            self.mesh, vertices=vertices.astype(np.float32), normals=normals.astype(np.float32)
        )

    def _blended(self, transforms: Bones) -> Float64[np.ndarray, "num_vertices 3 4"]:
        """Blend the bones' transforms at each vertex by its weights."""
        return np.asarray(
            (self.weights @ transforms.reshape(len(transforms), 12)).reshape(-1, 3, 4)
        )

    def _moved(
        self, blended: Float64[np.ndarray, "num_vertices 3 4"]
    ) -> Float64[np.ndarray, "num_vertices 3"]:
        return np.asarray(
            np.einsum("vij,vj->vi", blended[:, :, :3], self.mesh.vertices) + blended[:, :, 3]
        )


def bone_transforms(pose: Pose, joints: Float64[np.ndarray, "num_bones 3"]) -> Bones:
    """Compute the rigid motion [R | t] of each bone from rest to a pose with a fixed pelvis."""
    resting = Turn()
    turns = turn_matrices(np.array([pose.get(bone, resting) for bone in Bone], dtype=np.float64))
    transforms = np.empty((len(joints), 3, 4))
    rotations, places = transforms[:, :, :3], joints.copy()
    for bone, parent in enumerate(_PARENTS):
        if parent < 0:
            rotations[bone] = turns[bone]
        else:
            rotations[bone] = rotations[parent] @ turns[bone]
            places[bone] = places[parent] + rotations[parent] @ (joints[bone] - joints[parent])
    transforms[:, :, 3] = places - np.einsum("bij,bj->bi", rotations, joints)
    return transforms


def turn_matrices(
    turns: Float64[np.ndarray, "num_turns 3"],
) -> Float64[np.ndarray, "num_turns 3 3"]:
    """Compute the rotations of `Turn`s: first forward, then left, then the twist."""
    (cf, cl, ct), (sf, sl, st) = np.cos(turns).T, np.sin(turns).T
    zero, one = np.zeros_like(cf), np.ones_like(cf)
    forward = np.array([[cf, zero, -sf], [zero, one, zero], [sf, zero, cf]])
    left = np.array([[one, zero, zero], [zero, cl, -sl], [zero, sl, cl]])
    twist = np.array([[ct, -st, zero], [st, ct, zero], [zero, zero, one]])
    return np.asarray(np.einsum("ijn,jkn,kln->nil", twist, left, forward))


def rigid(mesh: Mesh, bone: Bone) -> Skinned:
    """Bind a part to one bone."""
    weights = np.zeros((len(mesh.vertices), len(Bone)), dtype=np.float32)
    weights[:, bone] = 1.0
    return Skinned(mesh=mesh, weights=weights)


def chained(
    mesh: Mesh, bones: Sequence[Bone], borders: Sequence[float], *, softness: float = 0.045
) -> Skinned:
    """Bind a part to a chain of bones, top to bottom, which blend at `borders`."""
    height = mesh.vertices[:, 2]
    weights = np.zeros((len(height), len(Bone)), dtype=np.float32)
    remaining = np.ones_like(height)
    for bone, border in zip(bones[:-1], borders, strict=True):
        passed = np.clip((border + softness - height) / (2 * softness), 0.0, 1.0)
        passed = passed * passed * (3 - 2 * passed)
        weights[:, bone] = remaining * (1 - passed)
        remaining = remaining * passed
    weights[:, bones[-1]] += remaining
    return Skinned(mesh=mesh, weights=weights)


class Reach(NamedTuple):
    """Angles at which a limb of two bones reaches a point [rad]."""

    toward: float  # forward rotation from hanging to the point
    opening: float
    """Angle between the first bone and the line to the point: a knee is ahead of it, an elbow
    behind."""
    bend: float  # angle between the bones; 0 is a straight limb


def reach(ahead: float, above: float, upper: float, lower: float) -> Reach:
    """Compute the angles that bring a limb's end to a point, or as near as its length allows.

    The point is `ahead` of the limb's root and `above` it [m]; `upper` and `lower` are the lengths
    of the bones [m].
    """
    distance = min(float(np.hypot(ahead, above)), 0.999 * (upper + lower))
    opening = (upper**2 + distance**2 - lower**2) / (2 * upper * distance)
    corner = (upper**2 + lower**2 - distance**2) / (2 * upper * lower)
    return Reach(
        toward=float(np.arctan2(ahead, -above)),
        opening=float(np.arccos(np.clip(opening, -1, 1))),
        bend=np.pi - float(np.arccos(np.clip(corner, -1, 1))),
    )

"""Meshes painted cell by cell, turned, mirrored and stretched."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64, Int

from sightline.simulation.meshes.primitives import Finish, Vector
from sightline.simulation.scene import Mesh


def painted(mesh: Mesh, cells: Int[np.ndarray, "rows columns"], palette: Sequence[Finish]) -> Mesh:
    """A `grid` whose cells have the finishes that `cells` picks from the palette."""
    picked = np.repeat(cells.ravel(), 2)
    materials = np.array([finish.material for finish in palette], dtype=np.int32)
    colors = np.array([finish.color for finish in palette], dtype=np.float32)
    return replace(mesh, materials=materials[picked], colors=colors[picked])


def turned(mesh: Mesh, rotation: Float64[np.ndarray, "3 3"]) -> Mesh:
    """The mesh turned about the origin."""
    return replace(
        mesh,
        vertices=(mesh.vertices @ rotation.T).astype(np.float32),
        normals=(mesh.normals @ rotation.T).astype(np.float32),
    )


def mirrored(mesh: Mesh) -> Mesh:
    """The mesh's mirror image in the xz plane, as left and right of a vehicle."""
    flip = np.array([1, -1, 1], dtype=np.float32)
    faces = np.ascontiguousarray(mesh.faces[:, ::-1])
    return replace(mesh, vertices=mesh.vertices * flip, normals=mesh.normals * flip, faces=faces)


def fitted(mesh: Mesh, size_lwh: Vector) -> Mesh:
    """The mesh stretched to fill the upright box of that size [m] over the origin exactly."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    scale = np.asarray(size_lwh) / (high - low)
    origin = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    normals = mesh.normals / scale
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return replace(
        mesh,
        vertices=((mesh.vertices - origin) * scale).astype(np.float32),
        normals=normals.astype(np.float32),
    )

"""Edits of meshes: painting cell by cell, rotating, mirroring and stretching."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64, Int

from sightline.simulation.meshes.primitives import Finish, Vector, moved
from sightline.simulation.scene import Mesh


def painted(mesh: Mesh, cells: Int[np.ndarray, "rows columns"], palette: Sequence[Finish]) -> Mesh:
    """Paint a `grid` with the finishes that `cells` selects from the palette."""
    picked = np.repeat(cells.ravel(), 2)
    materials = np.array([finish.material for finish in palette], dtype=np.int32)
    colors = np.array([finish.color for finish in palette], dtype=np.float32)
    return replace(mesh, materials=materials[picked], colors=colors[picked])


def turned(mesh: Mesh, rotation: Float64[np.ndarray, "3 3"]) -> Mesh:
    """Rotate the mesh about the origin."""
    return replace(
        mesh,
        vertices=(mesh.vertices @ rotation.T).astype(np.float32),
        normals=(mesh.normals @ rotation.T).astype(np.float32),
    )


def mirrored(mesh: Mesh) -> Mesh:
    """Mirror the mesh in the xz plane, like left and right of a vehicle."""
    flip = np.array([1, -1, 1], dtype=np.float32)
    faces = np.ascontiguousarray(mesh.faces[:, ::-1])
    return replace(mesh, vertices=mesh.vertices * flip, normals=mesh.normals * flip, faces=faces)


def both_sides(*parts: Mesh) -> Mesh:
    """Join the parts and their mirror images."""
    own = Mesh.joined(parts)
    return Mesh.joined((own, mirrored(own)))


def fitted(mesh: Mesh, size_lwh: Vector) -> Mesh:
    """Stretch the mesh to fill exactly the upright box of a size [m] over the origin."""
    low, high = mesh.vertices.min(axis=0).astype(np.float64), mesh.vertices.max(axis=0)
    length, width, height = np.asarray(size_lwh, np.float64)
    centred = moved(mesh, (-(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -low[2]))
    ends, scale = np.array([-0.5, 0.5]), (width / (high - low)[1], height / (high - low)[2])
    return stretched(centred, ends * (high - low)[0], ends * length, scale)


def stretched(
    mesh: Mesh,
    knots: Float64[np.ndarray, " num_knots"],
    places: Float64[np.ndarray, " num_knots"],
    scale_yz: tuple[float, float],
) -> Mesh:
    """Change the mesh's lengths between places along x, its width and its height.

    Args:
        mesh: The mesh to stretch.
        knots: Places along x [m], in order.
        places: Their new positions [m]. Parts beyond the ends move with them.
        scale_yz: Factors for y and z.
    """
    knots = np.array([knots[0] - 1, *knots, knots[-1] + 1])
    places = np.array([places[0] - 1, *places, places[-1] + 1])
    x = mesh.vertices[:, 0]
    between = np.clip(np.searchsorted(knots, x), 1, len(knots) - 1) - 1
    slope = (np.diff(places) / np.diff(knots))[between]
    vertices = mesh.vertices * np.array([1.0, *scale_yz], np.float32)
    vertices[:, 0] = places[between] + slope * (x - knots[between])
    normals = mesh.normals / np.array([1.0, *scale_yz], np.float32)
    normals[:, 0] /= slope
    normals /= np.sqrt(np.square(normals).sum(axis=1, keepdims=True))
    return replace(mesh, vertices=vertices, normals=normals)

"""Requirements of every road user mesh."""

import numpy as np

from sightline.simulation.rays.raycast import Raycaster
from sightline.simulation.scene import SURFACES


def assert_sound(mesh):
    """Assert finite values, unit normals, valid indices, materials, colours, no empty faces."""
    for values in (mesh.vertices, mesh.normals, mesh.uvs, mesh.colors):
        assert np.isfinite(values).all()
    lengths = np.linalg.norm(mesh.normals, axis=1)
    assert np.abs(lengths - 1).max() < 1e-3
    assert mesh.faces.min() >= 0
    assert mesh.faces.max() < len(mesh.vertices)
    assert len(mesh.vertices) == len(mesh.normals) == len(mesh.uvs)
    assert len(mesh.faces) == len(mesh.materials) == len(mesh.colors)
    assert set(np.unique(mesh.materials).tolist()) <= {int(material) for material in SURFACES}
    assert mesh.colors.min() >= 0
    assert mesh.colors.max() <= 1
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces].astype(np.float64), 1, 0)
    doubled_areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    assert (doubled_areas > 1e-10).mean() > 0.99


def share_of_front_faces(mesh, num_rays=3000):
    """Share of rays, from a wide circle at eye level and above, that hit an outer side first.

    A face's outer side is the one from which its corners run counter-clockwise; the shading
    normal must be on that side too.
    """
    rng = np.random.default_rng(0)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    toward = rng.normal(size=(num_rays, 3))
    toward[:, 2] = 0.5 * np.abs(toward[:, 2])
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    origins = (low + high) / 2 + 30 * toward
    directions = low + rng.random((num_rays, 3)) * (high - low) - origins
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    hits = Raycaster(mesh).cast(origins.astype(np.float32), directions.astype(np.float32))
    is_hit = hits.faces >= 0
    assert is_hit.mean() > 0.1
    faces = mesh.faces[hits.faces[is_hit]]
    a, b, c = np.moveaxis(mesh.vertices[faces], 1, 0)
    outward = np.cross(b - a, c - a)
    second, third = hits.barycentric[is_hit].T
    weights = np.stack((1 - second - third, second, third), axis=1)
    shading = np.einsum("rc,rci->ri", weights, mesh.normals[faces])
    in_front = np.einsum("ri,ri->r", outward, directions[is_hit]) < 0
    agrees = np.einsum("ri,ri->r", outward, shading) > 0
    return (in_front & agrees).mean()

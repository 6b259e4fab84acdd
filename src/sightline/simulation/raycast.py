"""Rays against triangles, by Embree."""

from typing import NamedTuple

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from jaxtyping import Bool, Float32, Int32

from sightline.simulation.scene import Mesh


class Hits(NamedTuple):
    """What each ray meets first."""

    faces: Int32[np.ndarray, " num_rays"]
    """Index of the face; -1 = nothing."""
    distances: Float32[np.ndarray, " num_rays"]
    """Along the ray, in units of its direction; inf = nothing."""
    barycentric: Float32[np.ndarray, "num_rays 2"]
    """Weights of the face's second and third vertex."""


class Raycaster:
    """The acceleration structure over a mesh; rays are cast from any number of places at once."""

    def __init__(self, mesh: Mesh) -> None:
        self._scene = EmbreeScene()
        TriangleMesh(self._scene, mesh.vertices, mesh.faces)

    def cast(
        self,
        origins: Float32[np.ndarray, "num_rays 3"],
        directions: Float32[np.ndarray, "num_rays 3"],
    ) -> Hits:
        """The first hit of each ray."""
        if len(origins) == 0:
            return Hits(
                np.zeros(0, np.int32), np.zeros(0, np.float32), np.zeros((0, 2), np.float32)
            )
        found = self._scene.run(origins, directions, output=1)
        faces = found["primID"]
        distances = np.where(faces >= 0, found["tfar"], np.float32(np.inf))
        return Hits(faces, distances, np.stack((found["u"], found["v"]), axis=1))

    def occluded(
        self,
        origins: Float32[np.ndarray, "num_rays 3"],
        directions: Float32[np.ndarray, "num_rays 3"],
        max_distance_m: float = 1e4,
    ) -> Bool[np.ndarray, " num_rays"]:
        """Whether anything stands within `max_distance_m` along each ray (unit directions)."""
        if len(origins) == 0:
            return np.zeros(0, dtype=bool)
        limits = np.full(len(origins), max_distance_m, dtype=np.float32)
        faces: Int32[np.ndarray, " num_rays"] = self._scene.run(
            origins, directions, dists=limits, query="OCCLUDED"
        )
        return faces >= 0

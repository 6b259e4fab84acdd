"""Ray casting against triangles, by Embree."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Int32

from sightline.simulation.embree import EmbreeScene
from sightline.simulation.scene import Mesh


class Hits(NamedTuple):
    """First hit of each ray."""

    faces: Int32[np.ndarray, " num_rays"]
    """Index of the face; -1 = nothing."""
    distances: Float32[np.ndarray, " num_rays"]
    """Distance along the ray, in units of its direction; inf = nothing."""
    barycentric: Float32[np.ndarray, "num_rays 2"]
    """Weights of the face's second and third vertices."""


class Raycaster:
    """Acceleration structure over a mesh, for rays from any number of origins at once.

    Rays are cast eight at a time. If eight in a row have about the same origin and direction, as
    rays of neighbouring pixels do, `coherent` is faster; otherwise it is slower.
    """

    def __init__(self, mesh: Mesh) -> None:
        self._scene = EmbreeScene(mesh.vertices, mesh.faces)

    def cast(
        self,
        origins: Float32[np.ndarray, "num_rays 3"],
        directions: Float32[np.ndarray, "num_rays 3"],
        *,
        coherent: bool = False,
    ) -> Hits:
        """Find the first hit of each ray."""
        return Hits(*self._scene.intersect(origins, directions, coherent=coherent))

    def occluded(
        self,
        origins: Float32[np.ndarray, "num_rays 3"],
        directions: Float32[np.ndarray, "num_rays 3"],
        max_distance_m: float = 1e4,
        *,
        coherent: bool = False,
    ) -> Bool[np.ndarray, " num_rays"]:
        """Test whether anything is within `max_distance_m` along each ray (unit directions)."""
        return self._scene.occluded(origins, directions, max_distance_m, coherent=coherent)

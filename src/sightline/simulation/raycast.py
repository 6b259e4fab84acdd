"""Rays against triangles, by Embree."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Int32

from sightline.simulation.embree import EmbreeScene
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
    """The acceleration structure over a mesh; rays are cast from any number of places at once.

    Rays are cast eight at a time. Where eight in a row have about the same origin and direction, as
    those of neighbouring pixels do, `coherent` is faster; with others it is slower.
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
        """The first hit of each ray."""
        return Hits(*self._scene.intersect(origins, directions, coherent=coherent))

    def occluded(
        self,
        origins: Float32[np.ndarray, "num_rays 3"],
        directions: Float32[np.ndarray, "num_rays 3"],
        max_distance_m: float = 1e4,
        *,
        coherent: bool = False,
    ) -> Bool[np.ndarray, " num_rays"]:
        """Whether anything stands within `max_distance_m` along each ray (unit directions)."""
        return self._scene.occluded(origins, directions, max_distance_m, coherent=coherent)

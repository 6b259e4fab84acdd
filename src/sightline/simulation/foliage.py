"""Gaps in foliage: leaves are drawn on cards, and rays pass a card where it has no leaf."""

from typing import Final

import numpy as np
from jaxtyping import Int32

from sightline.ops.compiled import compiled
from sightline.simulation.materials import Material
from sightline.simulation.raycast import Hits, Raycaster
from sightline.simulation.surfaces import MeshTables, Rays
from sightline.simulation.texture_noise import value_noise
from sightline.simulation.vectors import dot, minus, row_of

_LEAF: Final = int(Material.LEAF)
_MOST_CARDS: Final = 3
"""Maximum number of cards that a ray can pass; the next one stops it."""
_PASSED_M: Final = 0.002
_LARGEST_CARD_M: Final = 6.0
"""Maximum diagonal of a card of leaves; anything larger is a distant wood."""
_LEAVES_PER_METRE: Final = 11.0
_OPENNESS: Final = -0.12
"""Noise level, from -1 to 1, below which there is no leaf."""


def cast_through_foliage(raycaster: Raycaster, mesh: MeshTables, rays: Rays) -> Hits:
    """Find the first hit of each ray, with rays passing through the gaps of foliage.

    This is `Raycaster.cast` for rays in the order of pixels or of LiDAR firings.
    """
    hits = raycaster.cast(rays.origins, rays.directions, coherent=True)
    passing = np.arange(len(hits.faces), dtype=np.int32)
    for _ in range(_MOST_CARDS):
        passing = passing[_in_gap(mesh, hits, passing)]
        if len(passing) == 0:
            break
        lengths = np.linalg.norm(rays.directions[passing], axis=1)
        passed = hits.distances[passing] + np.float32(_PASSED_M) / lengths
        ways = rays.directions[passing]
        beyond = raycaster.cast(rays.origins[passing] + passed[:, None] * ways, ways)
        hits.faces[passing] = beyond.faces
        hits.distances[passing] = beyond.distances + passed
        hits.barycentric[passing] = beyond.barycentric
    return hits


@compiled
def _in_gap(
    mesh: MeshTables, hits: Hits, rows: Int32[np.ndarray, " num_rays"]
) -> Int32[np.ndarray, " num_gaps"]:
    """Find the positions in `rows` of rays that met foliage in a gap between leaves."""
    found = np.empty(rows.shape[0], np.int32)
    count = 0
    for index in range(rows.shape[0]):
        row = rows[index]
        face = hits.faces[row]
        if face < 0 or mesh.materials[face] != _LEAF:
            continue
        b, c = np.float64(hits.barycentric[row, 0]), np.float64(hits.barycentric[row, 1])
        first, second, third = mesh.faces[face, 0], mesh.faces[face, 1], mesh.faces[face, 2]
        u = (1.0 - b - c) * mesh.uvs[first, 0] + b * mesh.uvs[second, 0] + c * mesh.uvs[third, 0]
        v = (1.0 - b - c) * mesh.uvs[first, 1] + b * mesh.uvs[second, 1] + c * mesh.uvs[third, 1]
        diagonal = minus(row_of(mesh.vertices, third), row_of(mesh.vertices, first))
        side = minus(row_of(mesh.vertices, second), row_of(mesh.vertices, first))
        if max(dot(diagonal, diagonal), dot(side, side)) > _LARGEST_CARD_M**2:
            continue
        # Both triangles of a card start at the same vertex, so it identifies the card.
        noise = value_noise(u * _LEAVES_PER_METRE, v * _LEAVES_PER_METRE, first)
        noise += 0.5 * value_noise(2.3 * u * _LEAVES_PER_METRE, 2.3 * v * _LEAVES_PER_METRE, first)
        if noise < _OPENNESS:
            found[count] = index
            count += 1
    return found[:count]

"""Antialiasing of edges: extra visibility rays, shaded by radiance borrowed from nearby pixels.

This is multisampling, as in graphics hardware: a pixel at an edge casts more rays, and each takes
the radiance of a neighbouring pixel on the same surface. Only surfaces that lie at no pixel's
centre are shaded separately.
"""

from typing import Final

import numpy as np
from jaxtyping import Bool, Float32, Int32

from sightline.ops.compiled import compiled
from sightline.simulation.materials import Material
from sightline.simulation.raycast import Hits
from sightline.simulation.surfaces import MeshTables, Rays, face_normal
from sightline.simulation.vectors import Vector, dot, minus, plus, row_of, scaled

_LEAF: Final = int(Material.LEAF)
_BEND: Final = 1.5e-3
"""Relative change of slope of 1 / depth over three pixels above which there is an edge.

The inverse depth of a plane is linear over the image, so only bends and steps change its slope.
"""
_COLOR_STEP: Final = 0.04
_SAME_CROWN_M: Final = 0.5
_SAME_DIRECTION: Final = 0.9
"""Minimum cosine between the normals of one surface."""
_SAME_PLANE: Final = 0.004
"""Maximum distance of a point from a plane that contains it, as a share of the depth."""


def edge_pixels(
    mesh: MeshTables,
    owners: Int32[np.ndarray, " num_faces"],
    hits: Hits,
    image_size: tuple[int, int],
) -> Int32[np.ndarray, " num_edges"]:
    """Find the flat indices of pixels at edges, where a neighbour may show something else.

    `hits` has one row per pixel; its distances are depths along the optical axis.
    """
    is_edge = np.zeros(image_size, bool)
    _mark_edges(
        mesh, owners, hits.faces.reshape(image_size), hits.distances.reshape(image_size), is_edge
    )
    return np.flatnonzero(is_edge).astype(np.int32)


@compiled
def _mark_edges(
    mesh: MeshTables,
    owners: Int32[np.ndarray, " num_faces"],
    faces: Int32[np.ndarray, "height width"],
    depths: Float32[np.ndarray, "height width"],
    is_edge: Bool[np.ndarray, "height width"],
) -> None:
    height, width = faces.shape
    for row in range(height):
        for column in range(width):
            face, depth = faces[row, column], depths[row, column]
            for down in range(2):
                next_row, next_column = row + down, column + 1 - down
                if next_row >= height or next_column >= width:
                    continue
                other = faces[next_row, next_column]
                if other == face or _both_leaves(mesh, face, other):
                    continue
                differs = _differ(mesh, owners, face, other)
                last_row, last_column = row - down, column - 1 + down
                if not differs and last_row >= 0 and last_column >= 0:
                    near, far = depths[last_row, last_column], depths[next_row, next_column]
                    differs = abs(depth / near + depth / far - 2.0) > _BEND
                if differs:
                    is_edge[row, column] = True
                    is_edge[next_row, next_column] = True


@compiled
def _both_leaves(mesh: MeshTables, face: int, other: int) -> bool:
    """Test for two leaves, between which edges are ignored to save time: foliage is all edges."""
    if face < 0 or other < 0:
        return False
    return bool(mesh.materials[face] == _LEAF and mesh.materials[other] == _LEAF)


@compiled
def _differ(
    mesh: MeshTables, owners: Int32[np.ndarray, " num_faces"], face: int, other: int
) -> bool:
    """Test whether two faces belong to different objects or differ in material or colour."""
    if face < 0 or other < 0:
        return face != other
    if owners[face] != owners[other] or mesh.materials[face] != mesh.materials[other]:
        return True
    step = 0.0
    for channel in range(3):
        step = max(step, abs(mesh.colors[face, channel] - mesh.colors[other, channel]))
    return step > _COLOR_STEP


def lenders(
    mesh: MeshTables,
    owners: Int32[np.ndarray, " num_faces"],
    hits: Hits,
    image_size: tuple[int, int],
    more_rays: Rays,
    more_hits: Hits,
    pixels: Int32[np.ndarray, " num_more"],
) -> Int32[np.ndarray, " num_more"]:
    """Find a pixel on the same surface for each additional ray; -1 if there is none.

    `pixels` holds the flat index of the pixel of each additional ray.
    """
    found = np.empty(len(pixels), np.int32)
    _find_lenders(mesh, owners, hits.faces.reshape(image_size), more_rays, more_hits, pixels, found)
    return found


@compiled
def _find_lenders(
    mesh: MeshTables,
    owners: Int32[np.ndarray, " num_faces"],
    faces: Int32[np.ndarray, "height width"],
    more_rays: Rays,
    more_hits: Hits,
    pixels: Int32[np.ndarray, " num_more"],
    found: Int32[np.ndarray, " num_more"],
) -> None:
    height, width = faces.shape
    for ray in range(pixels.shape[0]):
        face = more_hits.faces[ray]
        way = scaled(row_of(more_rays.directions, ray), more_hits.distances[ray])
        reached = plus(row_of(more_rays.origins, ray), way)
        found[ray] = -1
        # The pixel itself, then its neighbours in reading order.
        for place in range(-1, 9):
            place_or_center = 4 if place < 0 else place
            row = pixels[ray] // width + place_or_center // 3 - 1
            column = pixels[ray] % width + place_or_center % 3 - 1
            if not (0 <= row < height and 0 <= column < width):
                continue
            other = faces[row, column]
            if other == face or (
                face >= 0
                and other >= 0
                and _same_surface(mesh, owners, face, other, reached, more_hits.distances[ray])
            ):
                found[ray] = row * width + column
                break


@compiled
def _same_surface(
    mesh: MeshTables,
    owners: Int32[np.ndarray, " num_faces"],
    face: int,
    other: int,
    reached: Vector,
    depth: float,
) -> bool:
    """Test whether a point on one face can take the radiance of the other face."""
    if _differ(mesh, owners, face, other):
        return False
    apart = minus(reached, row_of(mesh.vertices, mesh.faces[other, 0]))
    if mesh.materials[face] == _LEAF:
        return dot(apart, apart) < _SAME_CROWN_M * _SAME_CROWN_M
    normal = face_normal(mesh, other)
    if abs(dot(normal, face_normal(mesh, face))) < _SAME_DIRECTION:
        return False
    return abs(dot(normal, apart)) < _SAME_PLANE * depth

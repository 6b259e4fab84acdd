"""Surfaces hit by rays: place, normals and textured albedo; foliage lets rays pass its gaps."""

import math
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float32, Float64, Int32

from sightline.ops.compiled import compiled
from sightline.simulation.arrays import RayRows, RayValues, RayVectors
from sightline.simulation.rays.kernels import (
    Spot,
    Vector,
    cross,
    dot,
    luminance,
    minus,
    normalized,
    plus,
    row_of,
    scaled,
    store_row,
    value_noise,
    weighted,
)
from sightline.simulation.rays.raycast import Hits, Raycaster
from sightline.simulation.rays.textures import ROAD_PAINT_LUMINANCE, Textured, textured
from sightline.simulation.scene import SURFACES, Material, Mesh

NOTHING = -1  # material of a ray that hits nothing

_ASPHALT = int(Material.ASPHALT)
_PAVEMENT = int(Material.PAVEMENT)
_COBBLES = int(Material.COBBLES)
_WET_ASPHALT = int(Material.WET_ASPHALT)
_WET_PAVEMENT = int(Material.WET_PAVEMENT)
_WET_COBBLES = int(Material.WET_COBBLES)
WET: Final = {
    Material.ASPHALT: Material.WET_ASPHALT,
    Material.PAVEMENT: Material.WET_PAVEMENT,
    Material.COBBLES: Material.WET_COBBLES,
}
"""Wet surface of each dry one."""
_DAMP, _UNDER_WATER = 0.62, 0.4  # albedo of wet ground, as a share of the dry albedo
_RIPPLES: Final = 0.035  # slope of the water's surface
_LEAF = int(Material.LEAF)


class MeshTables(NamedTuple):
    """Mesh in the form for the kernels."""

    vertices: Float32[np.ndarray, "num_vertices 3"]
    normals: Float32[np.ndarray, "num_vertices 3"]
    uvs: Float32[np.ndarray, "num_vertices 2"]
    faces: Int32[np.ndarray, "num_faces 3"]
    materials: Int32[np.ndarray, " num_faces"]
    colors: Float32[np.ndarray, "num_faces 3"]


class MaterialTables(NamedTuple):
    """`SURFACES` as arrays, one row per material."""

    mirror: Float64[np.ndarray, " num_materials"]
    highlight: Float64[np.ndarray, " num_materials"]
    highlight_power: Float64[np.ndarray, " num_materials"]


class Rays(NamedTuple):
    """Origins and directions of rays."""

    origins: RayVectors
    directions: RayVectors  # directions of any length but zero


class SurfaceHits(NamedTuple):
    """Surfaces hit by rays; without a hit, only `directions` and `materials` are valid."""

    positions: RayVectors
    directions: RayVectors  # direction of the ray, unit length
    distances: RayValues  # distance from the ray's origin [m]
    flat_normals: RayVectors
    """Normal of the triangle, on the side of the incoming ray."""
    normals: RayVectors
    """Normal interpolated between the vertices, on the same side."""
    tilted_normals: RayVectors  # `normals` with the relief of the texture
    albedos: RayVectors
    materials: RayRows  # `Material` of the surface, or NOTHING


def mesh_tables(mesh: Mesh) -> MeshTables:
    """Prepare a mesh for the kernels."""
    return MeshTables(
        vertices=np.ascontiguousarray(mesh.vertices, np.float32),
        normals=np.ascontiguousarray(mesh.normals, np.float32),
        uvs=np.ascontiguousarray(mesh.uvs, np.float32),
        faces=np.ascontiguousarray(mesh.faces, np.int32),
        materials=np.ascontiguousarray(mesh.materials, np.int32),
        colors=np.ascontiguousarray(mesh.colors, np.float32),
    )


def material_tables() -> MaterialTables:
    """Prepare `SURFACES` for the kernels."""
    surfaces = [SURFACES[material] for material in Material]
    return MaterialTables(
        mirror=np.array([surface.mirror for surface in surfaces]),
        highlight=np.array([surface.highlight for surface in surfaces]),
        highlight_power=np.array([surface.highlight_power for surface in surfaces]),
    )


def surfaces_at_hits(mesh: MeshTables, rays: Rays, hits: Hits, pixel_angle: float) -> SurfaceHits:
    """Compute the surface at each hit; `pixel_angle` [rad] is the spread of rays, for textures."""
    count = len(rays.directions)
    found = SurfaceHits(
        positions=np.empty((count, 3), np.float32),
        directions=np.empty((count, 3), np.float32),
        distances=np.empty(count, np.float32),
        flat_normals=np.empty((count, 3), np.float32),
        normals=np.empty((count, 3), np.float32),
        tilted_normals=np.empty((count, 3), np.float32),
        albedos=np.empty((count, 3), np.float32),
        materials=np.empty(count, np.int32),
    )
    _fill(mesh, rays, hits, pixel_angle, found)
    return found


@compiled
def _fill(mesh: MeshTables, rays: Rays, hits: Hits, pixel_angle: float, found: SurfaceHits) -> None:
    for ray in range(rays.directions.shape[0]):
        way = row_of(rays.directions, ray)
        length = math.sqrt(dot(way, way))
        unit = (way[0] / length, way[1] / length, way[2] / length)
        store_row(found.directions, ray, unit)
        face = hits.faces[ray]
        if face < 0:
            found.materials[ray] = NOTHING
            found.distances[ray] = np.inf
            continue
        found.materials[ray] = mesh.materials[face]
        found.distances[ray] = hits.distances[ray] * length
        for axis in range(3):
            found.positions[ray, axis] = rays.origins[ray, axis] + hits.distances[ray] * way[axis]
        _fill_surface(mesh, unit, hits, ray, hits.distances[ray] * length * pixel_angle, found)


@compiled
def _fill_surface(
    mesh: MeshTables, unit: Vector, hits: Hits, ray: int, width: float, found: SurfaceHits
) -> None:
    """Compute normals and albedo of one hit; `width` is a pixel's size at its distance [m]."""
    face = hits.faces[ray]
    first, second, third = mesh.faces[face, 0], mesh.faces[face, 1], mesh.faces[face, 2]
    start = row_of(mesh.vertices, first)
    edge_a = minus(row_of(mesh.vertices, second), start)
    edge_b = minus(row_of(mesh.vertices, third), start)
    across = cross(edge_a, edge_b)
    twice_area = max(math.sqrt(dot(across, across)), 1e-12)
    flat = scaled(across, (-1.0 if dot(across, unit) > 0.0 else 1.0) / twice_area)
    b, c = np.float64(hits.barycentric[ray, 0]), np.float64(hits.barycentric[ray, 1])
    a = 1.0 - b - c
    normal = weighted(
        (a, b, c),
        row_of(mesh.normals, first),
        row_of(mesh.normals, second),
        row_of(mesh.normals, third),
    )
    material = mesh.materials[face]
    # Foliage has the normals of the crown, not of its cards.
    if material != _LEAF and dot(normal, flat) < 0.0:
        normal = scaled(normal, -1.0)
    normal = normalized(normal, flat)

    u0, v0 = np.float64(mesh.uvs[first, 0]), np.float64(mesh.uvs[first, 1])
    change_u = (mesh.uvs[second, 0] - u0, mesh.uvs[third, 0] - u0)
    change_v = (mesh.uvs[second, 1] - v0, mesh.uvs[third, 1] - v0)
    # Gradients of the barycentric coordinates, and thus of u and v, over the triangle.
    squared = twice_area * twice_area
    toward_b = scaled(cross(edge_b, across), 1.0 / squared)
    toward_c = scaled(cross(across, edge_a), 1.0 / squared)
    along_u = plus(scaled(toward_b, change_u[0]), scaled(toward_c, change_u[1]))
    along_v = plus(scaled(toward_b, change_v[0]), scaled(toward_c, change_v[1]))
    side, rise = _pixel_on_surface(unit, flat, width)
    color = row_of(mesh.colors, face)
    dry = _dried(material)
    if dry == _ASPHALT and luminance(color) > ROAD_PAINT_LUMINANCE:
        # Every marking has its own u and v; it wears off like the road below it.
        u, v = np.float64(found.positions[ray, 0]), np.float64(found.positions[ray, 1])
        along_u, along_v = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
    else:
        u = u0 + b * change_u[0] + c * change_u[1]
        v = v0 + b * change_v[0] + c * change_v[1]
    width_u = abs(dot(along_u, side)) + abs(dot(along_u, rise))
    width_v = abs(dot(along_v, side)) + abs(dot(along_v, rise))
    texture = textured(dry, color, Spot(u, v, width_u, width_v, _seed_of(mesh, face)))
    if dry != material:
        texture = _under_water(texture, found.positions[ray, 0], found.positions[ray, 1])
    tilt = plus(scaled(along_u, texture.tilt_u), scaled(along_v, texture.tilt_v))
    store_row(found.flat_normals, ray, flat)
    store_row(found.normals, ray, normal)
    store_row(found.tilted_normals, ray, normalized(minus(normal, tilt), normal))
    store_row(found.albedos, ray, texture.color)


@compiled
def _dried(material: int) -> int:
    """Find the dry material of wet ground; others are unchanged."""
    if material == _WET_ASPHALT:
        return _ASPHALT
    if material == _WET_PAVEMENT:
        return _PAVEMENT
    return _COBBLES if material == _WET_COBBLES else material


@compiled
def is_wet(material: int) -> bool:
    """Test for wet ground."""
    return bool(_dried(material) != material)


@compiled
def puddle_share(x: float, y: float) -> float:
    """Compute how far water covers wet ground at a place [m]: 0 damp, 1 a puddle."""
    noise = value_noise(0.35 * x, 0.35 * y, 71) + 0.5 * value_noise(1.1 * x, 1.1 * y, 72)
    return min(max(1.8 * noise - 0.5, 0.0), 1.0)


@compiled
def _under_water(texture: Textured, x: float, y: float) -> Textured:
    """Darken a texture, and smooth its relief except for ripples."""
    puddle = puddle_share(x, y)
    kept = _DAMP + (_UNDER_WATER - _DAMP) * puddle
    rough = 0.3 * (1.0 - puddle)
    ripple_u = _RIPPLES * (value_noise(9.0 * x, 9.0 * y, 73) + value_noise(31.0 * x, 31.0 * y, 74))
    ripple_v = _RIPPLES * (value_noise(9.0 * x, 9.0 * y, 75) + value_noise(31.0 * x, 31.0 * y, 76))
    return Textured(
        scaled(texture.color, kept),
        rough * texture.tilt_u + ripple_u,
        rough * texture.tilt_v + ripple_v,
    )


@compiled
def _pixel_on_surface(unit: Vector, flat: Vector, width: float) -> tuple[Vector, Vector]:
    """Project the two sides of a pixel, `width` wide at the hit, onto the surface."""
    level = math.sqrt(unit[0] * unit[0] + unit[1] * unit[1])
    side = (unit[1] / level, -unit[0] / level, 0.0) if level > 1e-6 else (1.0, 0.0, 0.0)
    rise = cross(side, unit)
    facing = min(dot(unit, flat), -0.02)
    return (
        scaled(minus(side, scaled(unit, dot(side, flat) / facing)), width),
        scaled(minus(rise, scaled(unit, dot(rise, flat) / facing)), width),
    )


@compiled
def _seed_of(mesh: MeshTables, face: int) -> int:
    """Compute the seed of a face's texture, different for each colour and each card of foliage."""
    red, green, blue = row_of(mesh.colors, face)
    seed = int(8191.0 * red) * 7 + int(8191.0 * green) * 131 + int(8191.0 * blue)
    # Both triangles of a card start at the same vertex.
    return seed + 17 * mesh.faces[face, 0] if mesh.materials[face] == _LEAF else seed


@compiled
def face_normal(mesh: MeshTables, face: int) -> Vector:
    """Compute the unit normal of a face, by the order of its vertices."""
    start = row_of(mesh.vertices, mesh.faces[face, 0])
    edge_a = minus(row_of(mesh.vertices, mesh.faces[face, 1]), start)
    edge_b = minus(row_of(mesh.vertices, mesh.faces[face, 2]), start)
    return normalized(cross(edge_a, edge_b), (0.0, 0.0, 1.0))


_MAX_CARDS: Final = 3  # maximum number of cards that a ray can pass; the next one stops it
_PASSED_M: Final = 0.002
_LARGEST_CARD_M: Final = 6.0
"""Maximum diagonal of a card of leaves; anything larger is a distant wood."""
_LEAVES_PER_METRE: Final = 11.0
_OPENNESS: Final = -0.12  # noise level, from -1 to 1, below which there is no leaf


def cast_through_foliage(raycaster: Raycaster, mesh: MeshTables, rays: Rays) -> Hits:
    """Find the first hit of each ray, with rays passing through the gaps of foliage.

    This is `Raycaster.cast` for rays in the order of pixels or of LiDAR firings.
    """
    hits = raycaster.cast(rays.origins, rays.directions, coherent=True)
    passing = np.arange(len(hits.faces), dtype=np.int32)
    for _ in range(_MAX_CARDS):
        passing = passing[_in_gap(mesh, hits, passing)]
        if len(passing) == 0:
            break
        lengths = np.linalg.norm(rays.directions[passing], axis=1)
        passed = hits.distances[passing] + np.float32(_PASSED_M) / lengths
        directions = rays.directions[passing]
        beyond = raycaster.cast(rays.origins[passing] + passed[:, None] * directions, directions)
        hits.faces[passing] = beyond.faces
        hits.distances[passing] = beyond.distances + passed
        hits.barycentric[passing] = beyond.barycentric
    return hits


@compiled
def _in_gap(mesh: MeshTables, hits: Hits, rows: RayRows) -> Int32[np.ndarray, " num_gaps"]:
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

"""Ambient light: gathered at some of the pixels, smoothed, and interpolated to all.

Each point of a coarse grid casts a few rays. The rays of 4 x 4 neighbouring points differ so that
together they cover the hemisphere evenly. A filter over just as many points, without points on
other surfaces, then leaves no speckle.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Int32

from sightline.ops.compiled import compiled
from sightline.simulation.arrays import RayRows, RayValues, RayVectors
from sightline.simulation.camera.shading import (
    Daylight,
    LitWorld,
    RayBatch,
    guessed_ambient,
    lifted,
    perpendicular,
    smooth_sky,
)
from sightline.simulation.rays.kernels import (
    Vector,
    cross,
    dot,
    minus,
    plus,
    row_of,
    scaled,
    store_row,
)
from sightline.simulation.rays.raycast import Hits
from sightline.simulation.rays.surfaces import NOTHING, MeshTables, Rays, SurfaceHits, face_normal
from sightline.simulation.scene import Material

_TILE: Final = 4  # side length of the pattern of directions, in points
_LEAF: Final = int(Material.LEAF)
_LEAF_LIFT_M: Final = 0.06
_LEAF_REACH_M: Final = 1.2  # distance within which two points in a crown have the same light
_OPEN_AT_M: Final = 5.0  # distance at which a hit surface counts as open to the sky


class AmbientGrid(NamedTuple):
    """Ambient light at the points of every `stride`-th pixel."""

    radiance: Float32[np.ndarray, "rows columns 3"]  # cosine-weighted mean over the hemisphere
    positions: Float32[np.ndarray, "rows columns 3"]
    normals: Float32[np.ndarray, "rows columns 3"]
    distances: Float32[np.ndarray, "rows columns"]
    materials: Int32[np.ndarray, "rows columns"]
    stride: int


def gathered_ambient(
    world: LitWorld,
    found: SurfaceHits,
    image_size: tuple[int, int],
    *,
    stride: int,
    rays_per_point: int,
) -> AmbientGrid:
    """Gather and smooth the light around the surfaces of an image's pixels.

    The first height * width rows of `found` are the pixels.
    """
    height, width = image_size
    rows, columns = np.arange(0, height, stride), np.arange(0, width, stride)
    pixels = (rows[:, None] * width + columns).ravel()
    points = SurfaceHits(*(field[pixels] for field in found))
    shape = (len(rows), len(columns))
    batch = _rays_around(points, shape[1], rays_per_point)
    arriving = _arriving(world, batch.rays)
    radiance = np.zeros((len(pixels), 3), np.float32)
    _average(batch.sources, arriving, rays_per_point, radiance)
    grid = AmbientGrid(
        radiance=radiance.reshape(*shape, 3),
        positions=points.positions.reshape(*shape, 3),
        normals=points.normals.reshape(*shape, 3),
        distances=points.distances.reshape(shape),
        materials=points.materials.reshape(shape),
        stride=stride,
    )
    smooth = np.zeros_like(grid.radiance)
    _smooth(grid, smooth)
    return grid._replace(radiance=smooth)


@compiled
def _rays_around(points: SurfaceHits, columns: int, rays_per_point: int) -> RayBatch:
    """Sample cosine-weighted rays over the hemisphere of each point."""
    count = points.materials.shape[0] * rays_per_point
    sources = np.empty(count, np.int32)
    origins, directions = np.empty((count, 3), np.float32), np.empty((count, 3), np.float32)
    used = 0
    for row in range(points.materials.shape[0]):
        if points.materials[row] == NOTHING:
            continue
        place = _TILE * ((row // columns) % _TILE) + (row % columns) % _TILE
        normal = row_of(points.normals, row)
        side, rise = perpendicular(normal)
        for ray in range(rays_per_point):
            direction = _tilted_away(points, row, _spread(place, ray, rays_per_point, side, rise))
            start = lifted(points, row)
            if points.materials[row] == _LEAF:
                start = plus(row_of(points.positions, row), scaled(direction, _LEAF_LIFT_M))
            sources[used] = row
            store_row(origins, used, start)
            store_row(directions, used, direction)
            used += 1
    return RayBatch(sources[:used], Rays(origins[:used], directions[:used]))


@compiled
def _spread(place: int, ray: int, rays: int, side: Vector, rise: Vector) -> Vector:
    """Compute the direction of one ray: each has its own cell of azimuth and ring of the disc."""
    cells = _TILE * _TILE
    reversed_place = (
        ((place & 1) << 3) | ((place & 2) << 1) | ((place & 4) >> 1) | ((place & 8) >> 3)
    )
    ring = (ray * 2 + ray // 2) % rays if rays % 2 == 0 else ray
    angle = 2.0 * math.pi * (ray + (place + 0.5) / cells) / rays
    squared = (ring + (reversed_place + 0.5) / cells) / rays
    radius, up = math.sqrt(squared), math.sqrt(1.0 - squared)
    across, along = radius * math.cos(angle), radius * math.sin(angle)
    normal = cross(side, rise)
    return plus(plus(scaled(side, across), scaled(rise, along)), scaled(normal, up))


@compiled
def _tilted_away(points: SurfaceHits, row: int, direction: Vector) -> Vector:
    """Mirror a direction that points into the surface, as the smooth normal may allow."""
    if points.materials[row] == _LEAF:
        return direction
    flat = row_of(points.flat_normals, row)
    depth = dot(direction, flat)
    if depth >= 0.0:
        return direction
    return minus(direction, scaled(flat, 2.0 * depth))


def _arriving(world: LitWorld, rays: Rays) -> RayVectors:
    """Compute the radiance along rays: the sky's, or that of a surface in sun and sky light."""
    hits = world.raycaster.cast(rays.origins, rays.directions)
    sun_visible = np.zeros(len(hits.faces), bool)
    if max(world.light.sun_color) > 0.0:
        batch = _bounce_sun_rays(world.mesh, world.light, rays, hits)
        hidden = world.raycaster.occluded(batch.rays.origins, batch.rays.directions)
        sun_visible[batch.sources[~hidden]] = True
    radiance = np.empty((len(hits.faces), 3), np.float32)
    _bounce(world.mesh, world.light, rays, hits, sun_visible, radiance)
    return radiance


@compiled
def _bounce_sun_rays(mesh: MeshTables, light: Daylight, rays: Rays, hits: Hits) -> RayBatch:
    """Build rays to the sun from the surfaces hit, if they face it."""
    count = hits.faces.shape[0]
    sources = np.empty(count, np.int32)
    origins, directions = np.empty((count, 3), np.float32), np.empty((count, 3), np.float32)
    used = 0
    for row in range(count):
        if hits.faces[row] < 0:
            continue
        way = row_of(rays.directions, row)
        flat = _normal_towards(mesh, hits.faces[row], way)
        if dot(flat, light.sun_direction) <= 0.05:
            continue
        reached = plus(row_of(rays.origins, row), scaled(way, hits.distances[row]))
        sources[used] = row
        store_row(origins, used, plus(reached, scaled(flat, 0.01)))
        store_row(directions, used, light.sun_direction)
        used += 1
    return RayBatch(sources[:used], Rays(origins[:used], directions[:used]))


@compiled
def _normal_towards(mesh: MeshTables, face: int, way: Vector) -> Vector:
    """Compute the normal of a face, on the side of the incoming ray."""
    flat = face_normal(mesh, face)
    return scaled(flat, -1.0) if dot(flat, way) > 0.0 else flat


@compiled
def _bounce(
    mesh: MeshTables,
    light: Daylight,
    rays: Rays,
    hits: Hits,
    sun_visible: Bool[np.ndarray, " num_rays"],
    radiance: RayVectors,
) -> None:
    for row in range(hits.faces.shape[0]):
        way = row_of(rays.directions, row)
        face = hits.faces[row]
        if face < 0:
            store_row(radiance, row, smooth_sky(light, way[2]))
            continue
        flat = _normal_towards(mesh, face, way)
        # A surface nearby and the point that views it hide the sky from each other.
        openness = 0.2 + 0.65 * min(1.0, hits.distances[row] / _OPEN_AT_M)
        arriving = scaled(guessed_ambient(light, flat), openness)
        if sun_visible[row]:
            facing = dot(flat, light.sun_direction) / math.pi
            arriving = plus(arriving, scaled(light.sun_color, facing))
        for channel in range(3):
            radiance[row, channel] = mesh.colors[face, channel] * arriving[channel]


@compiled
def _average(
    sources: RayRows,
    arriving: RayVectors,
    rays_per_point: int,
    radiance: Float32[np.ndarray, "num_points 3"],
) -> None:
    for ray in range(sources.shape[0]):
        for channel in range(3):
            radiance[sources[ray], channel] += arriving[ray, channel] / rays_per_point


@compiled
def _smooth(grid: AmbientGrid, smooth: Float32[np.ndarray, "rows columns 3"]) -> None:
    """Filter over 5 x 5 points of the same surface, which weighs every ray of a tile equally."""
    rows, columns = grid.materials.shape
    for row in range(rows):
        for column in range(columns):
            if grid.materials[row, column] == NOTHING:
                continue
            total, sums = 0.0, (0.0, 0.0, 0.0)
            for near_row in range(max(row - 2, 0), min(row + 3, rows)):
                for near_column in range(max(column - 2, 0), min(column + 3, columns)):
                    weight = 1.0 if abs(near_row - row) == 2 else 2.0
                    weight *= 1.0 if abs(near_column - column) == 2 else 2.0
                    weight *= _alike(
                        grid,
                        near_row,
                        near_column,
                        row_of(grid.positions[row], column),
                        row_of(grid.normals[row], column),
                        grid.distances[row, column],
                        grid.materials[row, column],
                    )
                    total += weight
                    near = row_of(grid.radiance[near_row], near_column)
                    sums = plus(sums, scaled(near, weight))
            store_row(smooth[row], column, scaled(sums, 1.0 / max(total, 1e-9)))


@compiled
def _alike(
    grid: AmbientGrid,
    row: int,
    column: int,
    position: Vector,
    normal: Vector,
    distance: float,
    material: int,
) -> float:
    """Compute the weight of a grid point's light at a place: 0..1."""
    other = grid.materials[row, column]
    if other == NOTHING or (other == _LEAF) != (material == _LEAF):
        return 0.0
    apart = minus(row_of(grid.positions[row], column), position)
    if material == _LEAF:
        return max(0.0, 1.0 - dot(apart, apart) / (_LEAF_REACH_M * _LEAF_REACH_M))
    turned = dot(row_of(grid.normals[row], column), normal)
    if turned <= 0.3:
        return 0.0
    height = dot(apart, normal) / (0.03 + 0.006 * distance)
    turned *= turned
    return max(0.0, 1.0 - height * height) * turned * turned


@compiled
def ambient_of(
    light: Daylight, grid: AmbientGrid, found: SurfaceHits, columns: RayValues, rows: RayValues
) -> RayVectors:
    """Interpolate the light at every surface from the grid points near its pixel (column, row)."""
    ambient = np.zeros((columns.shape[0], 3), np.float32)
    for ray in range(ambient.shape[0]):
        if found.materials[ray] == NOTHING:
            continue
        x, y = columns[ray] / grid.stride, rows[ray] / grid.stride
        # First the four surrounding points; if all are on other surfaces, twelve more.
        total, sums = _nearby(grid, found, ray, x, y, 1)
        if total < 0.02:
            total, sums = _nearby(grid, found, ray, x, y, 2)
        if total < 0.002:
            guess = guessed_ambient(light, row_of(found.normals, ray))
            total, sums = 1.0, scaled(guess, 0.6)
        store_row(ambient, ray, scaled(sums, 1.0 / total))
    return ambient


@compiled
def _nearby(
    grid: AmbientGrid, found: SurfaceHits, ray: int, x: float, y: float, reach: int
) -> tuple[float, Vector]:
    """Compute weight and weighted sum of the points less than `reach` columns and rows away."""
    position, normal = row_of(found.positions, ray), row_of(found.normals, ray)
    left, top = int(np.floor(x)), int(np.floor(y))
    total, sums = 0.0, (0.0, 0.0, 0.0)
    for row in range(max(top - reach + 1, 0), min(top + reach + 1, grid.materials.shape[0])):
        for column in range(
            max(left - reach + 1, 0), min(left + reach + 1, grid.materials.shape[1])
        ):
            weight = max(1.0 - abs(x - column) / reach, 0.0) + 1e-3
            weight *= max(1.0 - abs(y - row) / reach, 0.0) + 1e-3
            weight *= _alike(
                grid, row, column, position, normal, found.distances[ray], found.materials[ray]
            )
            total += weight
            sums = plus(sums, scaled(row_of(grid.radiance[row], column), weight))
    return total, sums

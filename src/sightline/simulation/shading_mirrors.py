"""Reflections of smooth surfaces: one mirror image, and the view through car glass."""

from typing import Final

import numpy as np
from jaxtyping import Float32, Int32

from sightline.ops.compiled import compiled
from sightline.simulation.materials import Material
from sightline.simulation.shading import LitWorld, RayBatch, lifted, shaded_directly
from sightline.simulation.surfaces import NOTHING, MaterialTables, Rays, SurfaceHits
from sightline.simulation.vectors import Vector, dot, minus, plus, row_of, scaled, store_row

_GLASS: Final = int(Material.GLASS)
_FAINTEST_IMAGE: Final = 0.02
"""Minimum reflectance that is worth a mirror ray."""
_GLASS_TINT: Final = 0.72
"""Share of the light transmitted by a pane."""
_INSIDE_AMBIENT: Final = 0.22
_OUTSIDE_AMBIENT: Final = 0.75
"""Light inside a car and in a street, as shares of the light in the open."""


def add_mirror_images(
    world: LitWorld,
    found: SurfaceHits,
    image_size: tuple[int, int],
    pixel_angle: float,
    radiance: Float32[np.ndarray, "num_rays 3"],
) -> None:
    """Add mirror images, and the view behind glass, to `radiance`, in place.

    The first height * width rows of `found` are the pixels of an image.
    """
    _add_behind_glass(world, found, pixel_angle, radiance)
    shares = np.zeros(len(radiance), np.float32)
    _mirror_shares(world.materials, found, shares)
    batch = _mirrored_rays(found, shares)
    # A curved mirror spreads the rays of a pixel, so textures in its image are sampled coarsely.
    seen, _ = shaded_directly(world, batch.rays, 4.0 * pixel_angle, _OUTSIDE_AMBIENT)
    images = np.zeros_like(radiance)
    images[batch.sources] = seen
    _blend(found, shares, images, image_size[0], image_size[1], radiance)


@compiled
def _mirror_shares(
    materials: MaterialTables, found: SurfaceHits, shares: Float32[np.ndarray, " num_rays"]
) -> None:
    """Compute the Fresnel reflectance of each surface (Schlick 1994, Eq. 15); 0 if too faint."""
    for row in range(shares.shape[0]):
        material = found.materials[row]
        if material == NOTHING or materials.mirror[material] <= 0.0:
            continue
        upright = materials.mirror[material]
        cosine = -dot(row_of(found.tilted_normals, row), row_of(found.directions, row))
        missing = 1.0 - min(max(cosine, 0.0), 1.0)
        share = upright + (1.0 - upright) * missing**5
        if share > _FAINTEST_IMAGE:
            shares[row] = share


@compiled
def _mirrored_rays(found: SurfaceHits, shares: Float32[np.ndarray, " num_rays"]) -> RayBatch:
    count = np.count_nonzero(shares)
    sources = np.empty(count, np.int32)
    origins, directions = np.empty((count, 3), np.float32), np.empty((count, 3), np.float32)
    used = 0
    for row in range(shares.shape[0]):
        if shares[row] > 0.0:
            mirrored = _reflected(row_of(found.directions, row), row_of(found.tilted_normals, row))
            flat = row_of(found.flat_normals, row)
            if dot(mirrored, flat) < 0.0:  # the smooth normal would send it into the surface
                mirrored = _reflected(mirrored, flat)
            sources[used] = row
            store_row(origins, used, lifted(found, row))
            store_row(directions, used, mirrored)
            used += 1
    return RayBatch(sources, Rays(origins, directions))


@compiled
def _reflected(way: Vector, normal: Vector) -> Vector:
    return minus(way, scaled(normal, 2.0 * dot(way, normal)))


@compiled
def _blend(
    found: SurfaceHits,
    shares: Float32[np.ndarray, " num_rays"],
    images: Float32[np.ndarray, "num_rays 3"],
    height: int,
    width: int,
    radiance: Float32[np.ndarray, "num_rays 3"],
) -> None:
    """Add mirror images, smoothed over 3 x 3 pixels with about the same mirror direction."""
    for row in range(shares.shape[0]):
        if shares[row] <= 0.0:
            continue
        total, image = 1.0, row_of(images, row)
        if row < height * width:
            normal = row_of(found.normals, row)
            for place in range(9):
                y, x = row // width + place // 3 - 1, row % width + place % 3 - 1
                other = y * width + x
                if place == 4 or not (0 <= y < height and 0 <= x < width) or shares[other] <= 0.0:
                    continue
                weight = 8.0 * dot(row_of(found.normals, other), normal) - 7.5
                if weight > 0.0 and found.materials[other] == found.materials[row]:
                    total += weight
                    image = plus(image, scaled(row_of(images, other), weight))
        for channel in range(3):
            mirrored = image[channel] / total
            radiance[row, channel] += shares[row] * (mirrored - radiance[row, channel])


def _add_behind_glass(
    world: LitWorld,
    found: SurfaceHits,
    pixel_angle: float,
    radiance: Float32[np.ndarray, "num_rays 3"],
) -> None:
    """Add the view through one pane into a car and through a second pane out of it."""
    panes = np.flatnonzero(found.materials == _GLASS).astype(np.int32)
    rays = _rays_through(found, panes)
    inside, met = shaded_directly(world, rays, pixel_angle, _INSIDE_AMBIENT)
    far_panes = np.flatnonzero(met.materials == _GLASS).astype(np.int32)
    outside, _ = shaded_directly(
        world, _rays_through(met, far_panes), pixel_angle, _OUTSIDE_AMBIENT
    )
    inside[far_panes] = outside * np.float32(_GLASS_TINT)
    radiance[panes] += inside * np.float32(_GLASS_TINT)


@compiled
def _rays_through(found: SurfaceHits, panes: Int32[np.ndarray, " num_panes"]) -> Rays:
    """Build rays that continue behind the surfaces of some rows."""
    origins = np.empty((panes.shape[0], 3), np.float32)
    directions = np.empty((panes.shape[0], 3), np.float32)
    for pane in range(panes.shape[0]):
        way = row_of(found.directions, panes[pane])
        position = row_of(found.positions, panes[pane])
        store_row(origins, pane, plus(position, scaled(way, 0.004)))
        store_row(directions, pane, way)
    return Rays(origins, directions)

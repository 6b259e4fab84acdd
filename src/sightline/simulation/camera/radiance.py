"""Radiance that reaches a camera's pixels, with reflections, before lens and sensor."""

from typing import Final

import numpy as np
from jaxtyping import Bool, Float32, Int32

from sightline.ops.compiled import compiled
from sightline.simulation.arrays import RayValues, RayVectors
from sightline.simulation.camera.ambient import ambient_of, gathered_ambient
from sightline.simulation.camera.samples import Samples
from sightline.simulation.camera.shading import (
    SUN_QUARTERS,
    SUN_STRATA,
    LitWorld,
    RayBatch,
    add_haze,
    lifted,
    shaded,
    shaded_directly,
    sun_visibility,
)
from sightline.simulation.rays.kernels import Vector, dot, minus, plus, row_of, scaled, store_row
from sightline.simulation.rays.surfaces import (
    NOTHING,
    MaterialTables,
    Rays,
    SurfaceHits,
    is_wet,
    puddle_share,
    surfaces_at_hits,
)
from sightline.simulation.scene import Material

_GLASS: Final = int(Material.GLASS)
_FAINTEST_IMAGE: Final = 0.02  # minimum reflectance that is worth a mirror ray
_WET_MIRROR: Final = 0.5  # largest reflectance of a puddle, which is never quite still
_DAMP_MIRROR: Final = 0.25  # reflectance of damp ground, as a share of a puddle's
_GLASS_TINT: Final = 0.72  # share of the light transmitted by a pane
_INSIDE_AMBIENT: Final = 0.22
_OUTSIDE_AMBIENT: Final = 0.75
"""Light inside a car and in a street, as shares of the light in the open."""


def add_mirror_images(
    world: LitWorld,
    found: SurfaceHits,
    image_size: tuple[int, int],
    pixel_angle: float,
    radiance: RayVectors,
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
def _mirror_shares(materials: MaterialTables, found: SurfaceHits, shares: RayValues) -> None:
    """Compute the Fresnel reflectance of each surface (Schlick 1994, Eq. 15); 0 if too faint."""
    for row in range(shares.shape[0]):
        material = found.materials[row]
        if material == NOTHING or materials.mirror[material] <= 0.0:
            continue
        upright = materials.mirror[material]
        cosine = -dot(row_of(found.tilted_normals, row), row_of(found.directions, row))
        missing = 1.0 - min(max(cosine, 0.0), 1.0)
        share = upright + (1.0 - upright) * missing**5
        if is_wet(material):
            place = row_of(found.positions, row)
            share = min(share, _WET_MIRROR)
            share *= _DAMP_MIRROR + (1.0 - _DAMP_MIRROR) * puddle_share(place[0], place[1])
        if share > _FAINTEST_IMAGE:
            shares[row] = share


@compiled
def _mirrored_rays(found: SurfaceHits, shares: RayValues) -> RayBatch:
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
    shares: RayValues,
    images: RayVectors,
    height: int,
    width: int,
    radiance: RayVectors,
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
    world: LitWorld, found: SurfaceHits, pixel_angle: float, radiance: RayVectors
) -> None:
    """Add the view through one pane into a car and through a second pane out of it."""
    panes = np.flatnonzero(found.materials == _GLASS).astype(np.int32)
    rays = _rays_through(found, panes)
    inside, inside_hits = shaded_directly(world, rays, pixel_angle, _INSIDE_AMBIENT)
    far_panes = np.flatnonzero(inside_hits.materials == _GLASS).astype(np.int32)
    outside, _ = shaded_directly(
        world, _rays_through(inside_hits, far_panes), pixel_angle, _OUTSIDE_AMBIENT
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


_LEAF: Final = int(Material.LEAF)
_SAME_PLANE: Final = 0.004
"""Maximum distance of a neighbour from the surface's plane, as a share of the distance."""


def pixel_radiance(
    world: LitWorld,
    samples: Samples,
    pixel_angle: float,
    *,
    ambient_stride: int,
    ambient_rays: int,
    brightest: float,
) -> Float32[np.ndarray, "height width 3"]:
    """Compute each pixel's linear RGB radiance: mean of its samples, clipped at `brightest`."""
    found = surfaces_at_hits(world.mesh, samples.rays, samples.hits, pixel_angle)
    sun_visible = _soft_sun(world, found, samples)
    grid = gathered_ambient(
        world, found, samples.image_size, stride=ambient_stride, rays_per_point=ambient_rays
    )
    ambient = ambient_of(world.light, grid, found, samples.columns, samples.rows)
    radiance = shaded(
        world.mesh, world.materials, world.light, found, samples.hits.faces, sun_visible, ambient
    )
    add_mirror_images(world, found, samples.image_size, pixel_angle, radiance)
    add_haze(world.light, found, radiance)
    np.minimum(radiance, np.float32(brightest), out=radiance)
    height, width = samples.image_size
    pixels = radiance[: height * width].copy()
    _blend_edges(radiance, samples.edges, samples.sample_rows, pixels)
    return pixels.reshape(height, width, 3)


def _soft_sun(world: LitWorld, found: SurfaceHits, samples: Samples) -> RayValues:
    """Compute the share of the sun's disc visible from each sample.

    One shadow ray per sample finds the borders of shadows. Pixels there cast three more, and the
    results of neighbouring pixels, which sample other quarters of the sun, are averaged.
    """
    height, width = samples.image_size
    everywhere = np.arange(len(samples.strata), dtype=np.int32)
    sun_visible = sun_visibility(world, found, everywhere, samples.strata)
    mixed = np.zeros((height, width), bool)
    _mark_mixed(sun_visible[: height * width].reshape(height, width), mixed)
    # Foliage mixes light and shade anyway, so it is left out.
    is_leaf = found.materials[: height * width] == _LEAF
    edges = np.flatnonzero(mixed.ravel() & ~is_leaf).astype(np.int32)
    for turn in range(1, SUN_STRATA // SUN_QUARTERS):
        strata = samples.strata[edges] + np.int32(turn * SUN_QUARTERS)
        sun_visible[edges] += sun_visibility(world, found, edges, strata)
    sun_visible[edges] /= SUN_STRATA // SUN_QUARTERS
    softened = sun_visible.copy()
    _soften(found, sun_visible, edges, height, width, softened)
    return softened


@compiled
def _mark_mixed(
    sun_visible: Float32[np.ndarray, "height width"], mixed: Bool[np.ndarray, "height width"]
) -> None:
    """Mark pixels with another sun visibility than one of their eight neighbours."""
    height, width = mixed.shape
    for row in range(height):
        for column in range(width):
            # Right, below left, below, below right: the other four are covered by symmetry.
            for place in range(4):
                y = row + min(place, 1)
                x = column + (1 if place == 0 else place - 2)
                if y < height and 0 <= x < width and sun_visible[row, column] != sun_visible[y, x]:
                    mixed[row, column] = mixed[y, x] = True


@compiled
def _soften(
    found: SurfaceHits,
    sun_visible: RayValues,
    pixels: Int32[np.ndarray, " num_mixed"],
    height: int,
    width: int,
    softened: RayValues,
) -> None:
    """Filter over 3 x 3 pixels with weights 1 2 1, which weighs all quarters of the sun equally."""
    for pixel in pixels:
        if found.materials[pixel] == NOTHING:
            continue
        row, column = pixel // width, pixel % width
        total, seen = 0.0, 0.0
        for down in range(-1, 2):
            for right in range(-1, 2):
                if not (0 <= row + down < height and 0 <= column + right < width):
                    continue
                other = pixel + down * width + right
                if other == pixel or _same_surface(found, pixel, other):
                    weight = (2.0 - abs(down)) * (2.0 - abs(right))
                    total += weight
                    seen += weight * sun_visible[other]
        softened[pixel] = seen / total


@compiled
def _same_surface(found: SurfaceHits, pixel: int, other: int) -> bool:
    if found.materials[other] == NOTHING:
        return False
    normal = row_of(found.normals, pixel)
    if dot(normal, row_of(found.normals, other)) < 0.8:
        return False
    apart = minus(row_of(found.positions, other), row_of(found.positions, pixel))
    return bool(abs(dot(apart, normal)) < _SAME_PLANE * found.distances[pixel])


@compiled
def _blend_edges(
    radiance: RayVectors,
    edges: Int32[np.ndarray, " num_edges"],
    sample_rows: Int32[np.ndarray, "num_offsets num_edges"],
    pixels: Float32[np.ndarray, "num_pixels 3"],
) -> None:
    """Replace the radiance of edge pixels by the mean over all their samples."""
    share = 1.0 / (1 + sample_rows.shape[0])
    for edge in range(edges.shape[0]):
        pixel = edges[edge]
        for channel in range(3):
            total = np.float64(radiance[pixel, channel])
            for offset in range(sample_rows.shape[0]):
                total += radiance[sample_rows[offset, edge], channel]
            pixels[pixel, channel] = share * total

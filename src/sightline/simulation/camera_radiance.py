"""Radiance that reaches a camera's pixels, before lens and sensor."""

from typing import Final

import numpy as np
from jaxtyping import Bool, Float32, Int32

from sightline.ops.compiled import compiled
from sightline.simulation.camera_rays import Samples
from sightline.simulation.materials import Material
from sightline.simulation.shading import (
    SUN_QUARTERS,
    SUN_STRATA,
    LitWorld,
    add_haze,
    shaded,
    sun_visibility,
)
from sightline.simulation.shading_ambient import ambient_of, gathered_ambient
from sightline.simulation.shading_mirrors import add_mirror_images
from sightline.simulation.surfaces import NOTHING, SurfaceHits, surfaces_met
from sightline.simulation.vectors import dot, minus, row_of

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
    found = surfaces_met(world.mesh, samples.rays, samples.hits, pixel_angle)
    sun_visible = _soft_sun(world, found, samples)
    grid = gathered_ambient(
        world, found, samples.image_size, stride=ambient_stride, rays_per_point=ambient_rays
    )
    ambient = ambient_of(world, grid, found, samples.columns, samples.rows)
    radiance = shaded(world, found, samples.hits.faces, sun_visible, ambient)
    add_mirror_images(world, found, samples.image_size, pixel_angle, radiance)
    add_haze(world.light, found, radiance)
    np.minimum(radiance, np.float32(brightest), out=radiance)
    height, width = samples.image_size
    pixels = radiance[: height * width].copy()
    _blend_edges(radiance, samples.edges, samples.shown, pixels)
    return pixels.reshape(height, width, 3)


def _soft_sun(
    world: LitWorld, found: SurfaceHits, samples: Samples
) -> Float32[np.ndarray, " num_rays"]:
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
    sun_visible: Float32[np.ndarray, " num_rays"],
    pixels: Int32[np.ndarray, " num_mixed"],
    height: int,
    width: int,
    softened: Float32[np.ndarray, " num_rays"],
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
    radiance: Float32[np.ndarray, "num_rays 3"],
    edges: Int32[np.ndarray, " num_edges"],
    shown: Int32[np.ndarray, "num_offsets num_edges"],
    pixels: Float32[np.ndarray, "num_pixels 3"],
) -> None:
    """Replace the radiance of edge pixels by the mean over all their samples."""
    share = 1.0 / (1 + shown.shape[0])
    for edge in range(edges.shape[0]):
        pixel = edges[edge]
        for channel in range(3):
            total = np.float64(radiance[pixel, channel])
            for offset in range(shown.shape[0]):
                total += radiance[shown[offset, edge], channel]
            pixels[pixel, channel] = share * total

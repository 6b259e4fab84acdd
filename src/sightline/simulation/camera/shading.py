"""Shading: sky, sun with soft shadow, highlights, lamps and haze, by compiled kernels."""

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from sightline.ops.compiled import compiled
from sightline.simulation.arrays import RayRows, RayValues, RayVectors
from sightline.simulation.rays.kernels import (
    Vector,
    dot,
    hashed,
    luminance,
    minus,
    normalized,
    row_of,
    scaled,
    store_row,
    value_noise,
)
from sightline.simulation.rays.raycast import Raycaster
from sightline.simulation.rays.surfaces import (
    NOTHING,
    MaterialTables,
    MeshTables,
    Rays,
    SurfaceHits,
    material_tables,
    mesh_tables,
    surfaces_at_hits,
)
from sightline.simulation.scene import Light, Material, Scene

_LAMPS_OFF_IRRADIANCE: Final = 2.0
_LAMPS_ON_IRRADIANCE: Final = 0.8
_GROUND_SHARE: Final = 0.4  # radiance of the land below the horizon, as a share of the horizon's


class Daylight(NamedTuple):
    """`Light` in the form for the compiled kernels."""

    sun_direction: Vector  # unit vector towards the sun, world frame
    sun_color: Vector  # irradiance of a surface that faces the unoccluded sun
    sky_zenith: Vector
    sky_horizon: Vector  # radiance of the sky at the horizon
    cloud_cover: float
    haze_m: float
    lamps: float  # radiance of a lit lamp; 0 by day
    seed: int  # seed of the clouds


def daylight(light: Light) -> Daylight:
    """Prepare a light for the kernels.

    Lamps start when the ground, open to the sky, gets less than 2 units of irradiance, and are
    fully on from 0.8 down (a clear day has about 10). They look equally bright at every exposure:
    with an exposure for dusk, a lamp looks as it does at night.
    """
    sky = math.pi * (luminance(light.sky_zenith) + luminance(light.sky_horizon)) / 2
    irradiance = sky + luminance(light.sun_color) * max(light.sun_direction[2], 0.0)
    lit = (_LAMPS_OFF_IRRADIANCE - irradiance) / (_LAMPS_OFF_IRRADIANCE - _LAMPS_ON_IRRADIANCE)
    # All moments of a drive have the same clouds: the seed must not change with time.
    seed = int(abs(1e4 * light.sun_direction[0] + 3e5 * light.sun_direction[1]))
    return Daylight(
        sun_direction=_color(light.sun_direction),
        sun_color=_color(light.sun_color),
        sky_zenith=_color(light.sky_zenith),
        sky_horizon=_color(light.sky_horizon),
        cloud_cover=float(light.cloud_cover),
        haze_m=float(light.haze_m),
        lamps=min(max(lit, 0.0), 1.0) / max(light.exposure, 1e-6),
        seed=seed,
    )


def _color(values: Vector) -> Vector:
    """Convert to plain floats, so that the kernels are compiled for one type only."""
    return float(values[0]), float(values[1]), float(values[2])


@compiled
def smooth_sky(light: Daylight, up: float) -> Vector:
    """Compute the sky's radiance at a height (the z of a unit direction) with evenly spread clouds.

    This lights the scene: it has no sun, no glow and no cloud shapes.
    """
    red, green, blue = _clear_sky(light, up)
    grey = luminance((red, green, blue))
    cover = 0.6 * light.cloud_cover
    return red + (grey - red) * cover, green + (grey - green) * cover, blue + (grey - blue) * cover


@compiled
def _clear_sky(light: Daylight, up: float) -> Vector:
    """Compute the radiance at a height without clouds, sun and glow; below 0 it is the land's."""
    rise = max(up, 0.0) ** 0.45
    land = 1.0 - (1.0 - _GROUND_SHARE) * min(max(-up * 30.0, 0.0), 1.0)
    red = (light.sky_horizon[0] + (light.sky_zenith[0] - light.sky_horizon[0]) * rise) * land
    green = (light.sky_horizon[1] + (light.sky_zenith[1] - light.sky_horizon[1]) * rise) * land
    blue = (light.sky_horizon[2] + (light.sky_zenith[2] - light.sky_horizon[2]) * rise) * land
    return red, green, blue


@compiled
def sky_radiance(light: Daylight, x: float, y: float, z: float) -> Vector:
    """Compute the radiance along a unit direction that meets no surface."""
    red, green, blue = _clear_sky(light, z)
    density = _cloud_density(light, x, y, z)
    if density > 0.0:
        grey = luminance((red, green, blue)) * (1.12 - 0.25 * density)
        sunlit = 0.16 * (1.0 - 0.55 * density) * (1.0 - light.cloud_cover)
        red += (grey + sunlit * light.sun_color[0] - red) * density
        green += (grey + sunlit * light.sun_color[1] - green) * density
        blue += (grey * 1.02 + sunlit * light.sun_color[2] - blue) * density
    glow = _sun_glow(light, x, y, z) * (1.0 - 0.8 * density)
    return (
        red + glow * light.sun_color[0],
        green + glow * light.sun_color[1],
        blue + glow * light.sun_color[2],
    )


@compiled
def _cloud_density(light: Daylight, x: float, y: float, z: float) -> float:
    """Compute the density of clouds in a direction, 0..1: noise on a plane high above."""
    if z <= 0.015 or light.cloud_cover <= 0.0:
        return 0.0
    distance = 0.9 / (z + 0.08)
    u, v = x * distance, y * distance
    total, size = 0.0, 1.0
    for octave in range(5):
        total += size * value_noise(u / size, v / size, light.seed + octave)
        size *= 0.5
    cover = (0.55 * total + 1.15 * light.cloud_cover - 0.45) * 2.2
    return min(max(cover, 0.0), 1.0) * min(1.0, (z - 0.015) * 12.0)


@compiled
def _sun_glow(light: Daylight, x: float, y: float, z: float) -> float:
    """Compute the glow around the sun per unit of its irradiance; the disc saturates a camera."""
    sun = light.sun_direction
    towards = x * sun[0] + y * sun[1] + z * sun[2]
    if towards <= 0.5 or z < -0.02:
        return 0.0
    squared = towards * towards
    wide = squared * squared * squared
    narrow = towards**220.0
    disc = 1.0 if towards > 0.99996 else 0.0
    return float(0.03 * wide + 0.35 * narrow + 20.0 * disc)


SUN_QUARTERS: Final = 4  # quarters of the sun's disc; each of four neighbouring pixels samples one
SUN_STRATA: Final = 16  # parts of the sun's disc, alternating between its quarters

_LEAF: Final = int(Material.LEAF)
_WINDOW: Final = int(Material.WINDOW)
_COATED_GLASS: Final = int(Material.COATED_GLASS)
_HEADLIGHT: Final = int(Material.HEADLIGHT)
_TAIL_LIGHT: Final = int(Material.TAIL_LIGHT)

_LEAF_TRANSMISSION: Final = 0.45
"""Sunlight transmitted by a leaf, as a share of its reflection if lit from the front."""
_HIGHLIGHT_GAIN: Final = 0.7
_HIGHLIGHT_SHARPNESS: Final = 6.0
"""Factor on `highlight_power`: the sun is small, and mirror rays cover the sky around it."""
_BOUNCE: Final = 0.18  # albedo of the surroundings if it is not looked up


@dataclass(frozen=True, kw_only=True, slots=True)
class LitWorld:
    """Scene prepared for shading."""

    raycaster: Raycaster
    mesh: MeshTables
    materials: MaterialTables
    light: Daylight
    sun_softness: float  # angular radius of the sun [rad]


class RayBatch(NamedTuple):
    """Rays that start on some of the surfaces."""

    sources: RayRows  # row of the surface at each ray's start
    rays: Rays


def lit_world(scene: Scene, raycaster: Raycaster) -> LitWorld:
    """Prepare a scene for shading; `raycaster` is over its mesh."""
    return LitWorld(
        raycaster=raycaster,
        mesh=mesh_tables(scene.mesh),
        materials=material_tables(),
        light=daylight(scene.light),
        sun_softness=scene.light.sun_softness,
    )


def sun_visibility(
    world: LitWorld, found: SurfaceHits, rows: RayRows, strata: RayRows
) -> RayValues:
    """Compute whether the sun is visible from each surface in `rows`: 1 or 0; 0 if it faces away.

    Each surface samples one part of the sun's disc, `strata`, from 0 to SUN_STRATA - 1.
    """
    visible = np.zeros(len(rows), np.float32)
    if max(world.light.sun_color) > 0.0:
        batch = _sun_rays(found, rows, world.light, world.sun_softness, strata)
        hidden = world.raycaster.occluded(batch.rays.origins, batch.rays.directions, coherent=True)
        visible[batch.sources[~hidden]] = 1.0
    return visible


@compiled
def _sun_rays(
    found: SurfaceHits, rows: RayRows, light: Daylight, softness: float, strata: RayRows
) -> RayBatch:
    sun = light.sun_direction
    side, rise = perpendicular(sun)
    count = rows.shape[0]
    sources = np.empty(count, np.int32)
    origins, directions = np.empty((count, 3), np.float32), np.empty((count, 3), np.float32)
    used = 0
    for ray in range(count):
        row = rows[ray]
        if found.materials[row] == NOTHING:
            continue
        is_leaf = found.materials[row] == _LEAF
        if not is_leaf and dot(row_of(found.tilted_normals, row), sun) <= 0.0:
            continue
        across, up = _place_on_disc(strata[ray])
        sources[used] = ray
        for axis in range(3):
            shift = softness * (across * side[axis] + up * rise[axis])
            directions[used, axis] = sun[axis] + shift
        store_row(origins, used, lifted(found, row))
        used += 1
    return RayBatch(sources[:used], Rays(origins[:used], directions[:used]))


@compiled
def _place_on_disc(stratum: int) -> tuple[float, float]:
    """Compute a point on the unit disc for a stratum, which is a ring within a quarter of it."""
    quarter, turn = stratum % SUN_QUARTERS, stratum // SUN_QUARTERS
    angle = 0.5 * math.pi * (quarter + (turn + 0.5) / SUN_QUARTERS)
    radius = math.sqrt(((quarter + turn) % SUN_QUARTERS + 0.5) / SUN_QUARTERS)
    return radius * math.cos(angle), radius * math.sin(angle)


@compiled
def lifted(found: SurfaceHits, row: int) -> Vector:
    """Compute a ray's origin on a surface, lifted so that the ray does not hit the surface."""
    lift = 0.002 + 1e-4 * found.distances[row]
    position, flat = row_of(found.positions, row), row_of(found.flat_normals, row)
    return (
        position[0] + lift * flat[0],
        position[1] + lift * flat[1],
        position[2] + lift * flat[2],
    )


@compiled
def perpendicular(axis: Vector) -> tuple[Vector, Vector]:
    """Compute two unit vectors perpendicular to a unit vector and to each other.

    Duff et al. 2017, Building an Orthonormal Basis, Revisited, Listing 3.
    """
    sign = 1.0 if axis[2] >= 0.0 else -1.0
    a = -1.0 / (sign + axis[2])
    b = axis[0] * axis[1] * a
    return (
        (1.0 + sign * axis[0] * axis[0] * a, sign * b, -sign * axis[0]),
        (b, sign + axis[1] * axis[1] * a, -axis[1]),
    )


@compiled
def shaded(
    mesh: MeshTables,
    materials: MaterialTables,
    light: Daylight,
    found: SurfaceHits,
    faces: RayRows,
    sun_visible: RayValues,
    ambient: RayVectors,
) -> RayVectors:
    """Compute the radiance returned along each ray, without mirror images and haze.

    `ambient` is the cosine-weighted mean of the incoming radiance.
    """
    radiance = np.empty((faces.shape[0], 3), np.float32)
    for row in range(faces.shape[0]):
        material = found.materials[row]
        view = row_of(found.directions, row)
        if material == NOTHING:
            store_row(radiance, row, sky_radiance(light, view[0], view[1], view[2]))
            continue
        normal = row_of(found.tilted_normals, row)
        facing = dot(normal, light.sun_direction)
        lit = sun_visible[row] * _sun_share(material, facing) / math.pi
        shine = 0.0
        if materials.highlight[material] > 0.0 and sun_visible[row] > 0.0 and facing > 0.0:
            shine = sun_visible[row] * _highlight(materials, material, light, normal, view)
        lamp = (0.0, 0.0, 0.0)
        if light.lamps > 0.0:
            lamp = _lamp(mesh, light, material, faces[row], row_of(found.albedos, row))
        for channel in range(3):
            arriving = ambient[row, channel] + lit * light.sun_color[channel]
            radiance[row, channel] = (
                found.albedos[row, channel] * arriving
                + shine * light.sun_color[channel]
                + lamp[channel]
            )
    return radiance


@compiled
def _sun_share(material: int, facing: float) -> float:
    """Compute the share of the sun's irradiance that a surface reflects, from the sun's cosine."""
    if material == _LEAF and facing < 0.0:
        return -_LEAF_TRANSMISSION * facing
    return max(facing, 0.0)


@compiled
def _highlight(
    materials: MaterialTables, material: int, light: Daylight, normal: Vector, view: Vector
) -> float:
    """Compute the sun's highlight per unit of its irradiance: Blinn-Phong."""
    middle = normalized(minus(light.sun_direction, view), normal)
    power = _HIGHLIGHT_SHARPNESS * materials.highlight_power[material]
    peak = _HIGHLIGHT_GAIN * materials.highlight[material]
    return float(peak * max(dot(normal, middle), 0.0) ** power)


@compiled
def _lamp(mesh: MeshTables, light: Daylight, material: int, face: int, albedo: Vector) -> Vector:
    """Compute the radiance of glowing surfaces at dusk: lamps, and windows of lit rooms."""
    if material == _HEADLIGHT:
        return scaled(albedo, 4.0 * light.lamps)
    if material == _TAIL_LIGHT:
        return scaled(albedo, 0.9 * light.lamps)
    if material in (_WINDOW, _COATED_GLASS):
        # The two triangles of a pane share their first vertex.
        corner = mesh.faces[face, 0]
        chance = hashed(
            int(100.0 * mesh.vertices[corner, 0]),
            int(100.0 * mesh.vertices[corner, 1]),
            int(100.0 * mesh.vertices[corner, 2]),
        )
        if chance < 0.35:
            glow = light.lamps * (0.10 + 0.7 * chance)
            return glow, glow * 0.72, glow * 0.38
    return 0.0, 0.0, 0.0


@compiled
def add_haze(light: Daylight, found: SurfaceHits, radiance: RayVectors) -> None:
    """Blend distant surfaces into the colour of the horizon, in place."""
    air = smooth_sky(light, 0.03)
    for row in range(radiance.shape[0]):
        if found.materials[row] != NOTHING:
            clear = math.exp(-found.distances[row] / light.haze_m)
            for channel in range(3):
                radiance[row, channel] = radiance[row, channel] * clear + air[channel] * (
                    1.0 - clear
                )


@compiled
def guessed_ambient(light: Daylight, normal: Vector) -> Vector:
    """Estimate the mean radiance around an unoccluded surface, from sky and sunlit ground."""
    sky, horizon = smooth_sky(light, 0.6), smooth_sky(light, 0.1)
    upward = 0.5 + 0.5 * normal[2]
    sun = max(light.sun_direction[2], 0.0) / math.pi
    red = 0.5 * (sky[0] + horizon[0])
    green = 0.5 * (sky[1] + horizon[1])
    blue = 0.5 * (sky[2] + horizon[2])
    below = (1.0 - upward) * _BOUNCE
    return (
        red * upward + below * (red + 0.6 * sun * light.sun_color[0]),
        green * upward + below * (green + 0.6 * sun * light.sun_color[1]),
        blue * upward + below * (blue + 0.6 * sun * light.sun_color[2]),
    )


@compiled
def _guessed(light: Daylight, found: SurfaceHits, share: float) -> RayVectors:
    ambient = np.zeros((found.materials.shape[0], 3), np.float32)
    for row in range(ambient.shape[0]):
        if found.materials[row] != NOTHING:
            guess = guessed_ambient(light, row_of(found.normals, row))
            store_row(ambient, row, scaled(guess, share))
    return ambient


def shaded_directly(
    world: LitWorld, rays: Rays, pixel_angle: float, ambient_share: float
) -> tuple[RayVectors, SurfaceHits]:
    """Compute radiance and surfaces along rays: sun and estimated ambient light, no mirrors."""
    hits = world.raycaster.cast(rays.origins, rays.directions)
    found = surfaces_at_hits(world.mesh, rays, hits, pixel_angle)
    rows = np.arange(len(hits.faces), dtype=np.int32)
    sun_visible = sun_visibility(world, found, rows, rows % np.int32(SUN_STRATA))
    ambient = _guessed(world.light, found, ambient_share)
    lit = world.mesh, world.materials, world.light
    return shaded(*lit, found, hits.faces, sun_visible, ambient), found

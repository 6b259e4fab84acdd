"""Sky model: a gradient with sun glow and clouds, and its brightness as a light source."""

import math
from typing import Final, NamedTuple

from sightline.ops.compiled import compiled
from sightline.simulation.scene import Light
from sightline.simulation.texture_noise import value_noise
from sightline.simulation.vectors import Vector, luminance

_LAMPS_OFF_IRRADIANCE: Final = 2.0
_LAMPS_ON_IRRADIANCE: Final = 0.8
_GROUND_SHARE: Final = 0.4
"""Radiance of the land below the horizon, as a share of the horizon's."""


class Daylight(NamedTuple):
    """`Light` in the form for the compiled kernels."""

    sun_direction: Vector
    """Unit vector towards the sun, world frame."""
    sun_color: Vector
    """Irradiance of a surface that faces the unoccluded sun."""
    sky_zenith: Vector
    sky_horizon: Vector
    """Radiance of the sky at the horizon."""
    cloud_cover: float
    haze_m: float
    lamps: float
    """Radiance of a lit lamp; 0 by day."""
    seed: int
    """Seed of the clouds."""


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

"""Sun and sky: clear and cloudy days, low sun, overcast and dusk."""

from typing import Final

import numpy as np

from sightline.simulation.scene import Light

_CLEAR: Final = 0.52
_CLOUDY: Final = 0.75
_LOW_SUN: Final = 0.85
_OVERCAST: Final = 0.95
"""Cumulative shares of each weather; the rest is dusk. KITTI was recorded by day."""


def draw_light(rng: np.random.Generator) -> Light:
    """Draw the light of a street: mostly a clear or partly cloudy day."""
    weather = rng.random()
    azimuth = float(rng.uniform(-np.pi, np.pi))
    if weather < _CLEAR:
        return _day(rng, azimuth, cloud_cover=float(rng.uniform(0.0, 0.25)))
    if weather < _CLOUDY:
        return _day(rng, azimuth, cloud_cover=float(rng.uniform(0.35, 0.6)))
    if weather < _LOW_SUN:
        return _low_sun(rng, azimuth)
    if weather < _OVERCAST:
        return _overcast(rng, azimuth)
    return _dusk(rng, azimuth)


def _sun_direction(elevation: float, azimuth: float) -> tuple[float, float, float]:
    return (
        float(np.cos(elevation) * np.cos(azimuth)),
        float(np.cos(elevation) * np.sin(azimuth)),
        float(np.sin(elevation)),
    )


def _scaled(color: tuple[float, float, float], factor: float) -> tuple[float, float, float]:
    red, green, blue = color
    return red * factor, green * factor, blue * factor


def _day(rng: np.random.Generator, azimuth: float, cloud_cover: float) -> Light:
    """Draw a day with the sun 22 to 55 degrees high; irradiance of 7 to 11 units on the ground."""
    elevation = float(np.radians(rng.uniform(22.0, 55.0)))
    strength = 12.0 * (1.0 - 0.25 * cloud_cover)
    warmth = float(np.clip((elevation - 0.3) / 0.6, 0.0, 1.0))
    return Light(
        sun_direction=_sun_direction(elevation, azimuth),
        sun_color=_scaled((1.0, 0.90 + 0.05 * warmth, 0.74 + 0.12 * warmth), strength),
        sun_softness=0.0047 + 0.01 * cloud_cover,
        sky_zenith=_scaled((0.30, 0.55, 1.0), 0.40 + 0.5 * cloud_cover),
        sky_horizon=_scaled((0.80, 0.92, 1.0), 0.72 + 0.4 * cloud_cover),
        cloud_cover=cloud_cover,
        haze_m=float(rng.uniform(900.0, 2500.0)),
        exposure=float(rng.uniform(0.23, 0.32)),
    )


def _low_sun(rng: np.random.Generator, azimuth: float) -> Light:
    """Draw a low sun with long shadows and warm light."""
    elevation = float(np.radians(rng.uniform(7.0, 18.0)))
    return Light(
        sun_direction=_sun_direction(elevation, azimuth),
        sun_color=_scaled((1.0, 0.74, 0.46), 6.5),
        sun_softness=0.006,
        sky_zenith=_scaled((0.32, 0.52, 0.95), 0.75),
        sky_horizon=_scaled((1.0, 0.88, 0.72), 1.25),
        cloud_cover=float(rng.uniform(0.0, 0.4)),
        haze_m=float(rng.uniform(500.0, 1200.0)),
        exposure=float(rng.uniform(0.38, 0.52)),
    )


def _overcast(rng: np.random.Generator, azimuth: float) -> Light:
    """Draw an overcast sky, without shadows."""
    return Light(
        sun_direction=_sun_direction(0.9, azimuth),
        sun_color=(0.0, 0.0, 0.0),
        sun_softness=0.05,
        sky_zenith=_scaled((0.92, 0.97, 1.05), 1.45),
        sky_horizon=_scaled((0.96, 0.98, 1.0), 1.25),
        cloud_cover=float(rng.uniform(0.9, 1.0)),
        haze_m=float(rng.uniform(350.0, 900.0)),
        exposure=float(rng.uniform(0.50, 0.68)),
    )


def _dusk(rng: np.random.Generator, azimuth: float) -> Light:
    """Draw dusk: the sun is down, lamps are lit."""
    return Light(
        sun_direction=_sun_direction(0.05, azimuth),
        sun_color=(0.0, 0.0, 0.0),
        sun_softness=0.02,
        sky_zenith=_scaled((0.28, 0.42, 0.85), 0.22),
        sky_horizon=_scaled((1.0, 0.72, 0.55), 0.26),
        cloud_cover=float(rng.uniform(0.0, 0.5)),
        haze_m=float(rng.uniform(500.0, 1000.0)),
        exposure=float(rng.uniform(1.8, 2.6)),
    )

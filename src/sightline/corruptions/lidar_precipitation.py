"""Rain and snow in a LiDAR sweep: Kilic et al. 2021, "LISA"."""

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import Annotated, Final, NamedTuple

import numpy as np
import torch
from jaxtyping import Float64

from sightline.corruptions.corruption import LidarCorruption, PointsChange, Sweep, everywhere
from sightline.corruptions.precipitation import Precipitation, rain, snow
from sightline.corruptions.sensor import (
    HDL_64E,
    SpinningLidar,
    clear_air_reflectances,
    faintest_power,
)
from sightline.geometry.ranges import Within
from sightline.structures.sample import CameraLidarSample

_RESOLUTION_M: Final = 0.09  # range resolution at a signal as strong as the noise
_LARGEST_MM: Final = 6.0  # melted; larger drops break up


@dataclass(frozen=True, kw_only=True, slots=True)
class _LidarPrecipitation(LidarCorruption):
    """Precipitation in a LiDAR sweep; see `fall_before`."""

    rate_mm_per_h: Annotated[float, Within(0.01, 300)]
    """Water rate; for snow, of the melted water."""
    lidar: SpinningLidar = HDL_64E

    @abstractmethod
    def particles(self) -> Precipitation:
        """Particles of the precipitation."""

    def change_points(
        self, points: Sweep, sample: CameraLidarSample, rng: np.random.Generator
    ) -> PointsChange:
        """Apply `fall_before`."""
        change = fall_before(points, sample, self.particles(), self.lidar, rng)
        rate = {"rate_mm_per_h": self.rate_mm_per_h}
        return change._replace(parameters={**rate, **change.parameters})


@dataclass(frozen=True, kw_only=True, slots=True)
class LidarRain(_LidarPrecipitation):
    """Rain: echoes fade and scatter, and near drops cause false points; see `fall_before`."""

    kind = "lidar_rain"

    def particles(self) -> Precipitation:
        """Rain at this rate."""
        return rain(self.rate_mm_per_h)


@dataclass(frozen=True, kw_only=True, slots=True)
class LidarSnow(_LidarPrecipitation):
    """Snow: like rain, with larger and whiter particles; see `fall_before`."""

    kind = "lidar_snow"
    revision = 2

    def particles(self) -> Precipitation:
        """Snow at this rate."""
        return snow(self.rate_mm_per_h)


class Echoes(NamedTuple):
    """Strongest echo of a particle in each beam."""

    ranges_m: Float64[np.ndarray, " num_beams"]
    reflectances: Float64[np.ndarray, " num_beams"]
    """Apparent reflectance of the particle, from the light received; 0 if there is none."""


def fall_before(
    points: Sweep,
    sample: CameraLidarSample,
    particles: Precipitation,
    lidar: SpinningLidar,
    rng: np.random.Generator,
) -> PointsChange:
    """Simulate a sweep in rain or snow, after Kilic et al. 2021.

    Powers are reflectance exp(-2 extinction range) / range^2. The strongest echo is kept, from the
    target or from a particle in the beam before it; an echo below the noise is lost. The target's
    range scatters by 0.09 m / sqrt(2 power / noise).

    Departures: extinction is by geometric optics (`Precipitation.extinction_per_m`), not by Mie's
    theory; particles too far away to be the strongest are not drawn; targets detected in clear air
    are assumed to have an echo above the noise.
    """
    ranges_m = np.linalg.norm(points[:, :3].double().numpy(), axis=1)
    reflectances = clear_air_reflectances(points, ranges_m, lidar, rng)
    echoes = strongest_particles(particles, lidar, ranges_m, rng)
    fading = np.exp(-2 * particles.extinction_per_m * ranges_m)
    noise = faintest_power(lidar)
    squares = np.maximum(ranges_m, 1e-9) ** 2
    power = reflectances * fading / squares
    particle_power = echoes.reflectances / np.maximum(echoes.ranges_m, 1e-9) ** 2
    is_particle = particle_power > power
    found = np.maximum(power, particle_power) >= noise
    spread_m = _RESOLUTION_M / np.sqrt(2 * np.maximum(power / noise, 1))
    new_ranges_m = np.where(
        is_particle, echoes.ranges_m, ranges_m + spread_m * rng.standard_normal(len(points))
    )
    factors = np.maximum(new_ranges_m, 0) / np.maximum(ranges_m, 1e-9)
    read = np.where(
        is_particle, np.minimum(echoes.reflectances, 1), points[:, 3].double().numpy() * fading
    )
    wet = points.clone()
    wet[:, :3] *= torch.from_numpy(factors.astype(np.float32))[:, None]
    wet[:, 3] = torch.from_numpy(read.astype(np.float32))
    rows = torch.from_numpy(np.flatnonzero(found))
    parameters = {
        "extinction_per_m": particles.extinction_per_m,
        "num_lost": int(len(points) - found.sum()),
        "num_particle_echoes": int((found & is_particle).sum()),
    }
    return PointsChange(wet[rows], rows, everywhere(sample), parameters)


def strongest_particles(
    particles: Precipitation,
    lidar: SpinningLidar,
    ranges_m: Float64[np.ndarray, " num_beams"],
    rng: np.random.Generator,
) -> Echoes:
    """Draw the particles in each beam, a cone, and select the strongest echo before the target.

    A particle that fills a part of the beam reflects that part.
    """
    reach_m = _reach_m(particles, lidar)
    half_angle = lidar.beam_divergence_mrad * 1e-3 / 2
    volume_m3 = math.pi / 3 * half_angle**2 * reach_m**3
    counts = rng.poisson(particles.per_cubic_metre * volume_m3, len(ranges_m))
    beams = np.repeat(np.arange(len(ranges_m)), counts)
    places_m = reach_m * np.cbrt(rng.random(len(beams)))
    diameters_m = particles.draw_diameters_m(len(beams), rng)
    filled = np.minimum((diameters_m / (2 * half_angle * places_m)) ** 2, 1)
    apparent = particles.reflectance * filled
    apparent *= np.exp(-2 * particles.extinction_per_m * places_m)
    is_before = (places_m >= lidar.min_range_m) & (places_m < ranges_m[beams])
    powers = np.where(is_before, apparent / places_m**2, 0.0)
    first = np.flatnonzero(np.diff(beams, prepend=-1))
    chosen_ranges, chosen_apparent = np.zeros(len(ranges_m)), np.zeros(len(ranges_m))
    if len(first):
        best = np.repeat(np.maximum.reduceat(powers, first), counts[counts > 0])
        # The strongest echo is written; of equal echoes, which have no power, any may be written.
        is_best = (powers == best) & (powers > 0)
        chosen_ranges[beams[is_best]] = places_m[is_best]
        chosen_apparent[beams[is_best]] = apparent[is_best]
    return Echoes(chosen_ranges, chosen_apparent)


def _reach_m(particles: Precipitation, lidar: SpinningLidar) -> float:
    """Compute the range at which the largest particle's echo, in part of the beam, equals noise.

    There, reflectance (diameter / (divergence range))^2 / range^2 is the noise.
    """
    size_m = particles.swelling * _LARGEST_MM * 1e-3 / (lidar.beam_divergence_mrad * 1e-3)
    ratio = particles.reflectance / faintest_power(lidar)
    return min(math.sqrt(math.sqrt(ratio) * size_m), lidar.max_range_m)

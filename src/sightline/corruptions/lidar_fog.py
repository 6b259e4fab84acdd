"""Fog in a LiDAR sweep: Hahner et al. 2021, "Fog simulation on real LiDAR point clouds"."""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Final, NamedTuple

import numpy as np
import torch
from jaxtyping import Float64

from sightline.corruptions.corruption import LidarCorruption, PointsChange, Sweep, everywhere
from sightline.corruptions.haze import VISIBLE_CONTRAST
from sightline.corruptions.sensor import (
    HDL_64E,
    SpinningLidar,
    clear_air_reflectances,
    faintest_power,
)
from sightline.geometry.ranges import Within
from sightline.structures.sample import CameraLidarSample

_LIGHT_MPS: Final = 299792458.0
_PULSE_S: Final = 20e-9  # half-power width
_CROSSOVER_M: Final = 0.1  # over which the receiver's view grows to the whole beam
_BACKSCATTER: Final = 0.046  # times 1 / visibility: Rasshofer et al. 2011
_TARGET_BACKSCATTER: Final = 1e-6 / math.pi  # differential reflectivity of a hard target, 1/sr
_STEP_M: Final = 0.1
_SLICES: Final = 200  # number of slices of a pulse
_SPREAD_M: Final = 20.0  # spread of the fog's echoes
_SPREAD_SHAPE: Final = (2.0, 20.0)


@dataclass(frozen=True, kw_only=True, slots=True)
class LidarFog(LidarCorruption):
    """Homogeneous fog: echoes fade, and the fog's own echo replaces a weaker one.

    The hard and the soft target are those of Hahner et al. 2021, with their constants. The fog's
    echoes lie 1.8 m on average (a beta distribution) behind the place of its strongest response.

    Departures: an echo below the detection limit (`faintest_power`) is lost; the fog's echoes
    spread twice as far as in the authors' code, and never lie behind the target.
    """

    kind = "lidar_fog"

    attenuation_per_m: Annotated[float, Within(1e-06, 10)]
    lidar: SpinningLidar = HDL_64E

    def change_points(
        self, points: Sweep, sample: CameraLidarSample, rng: np.random.Generator
    ) -> PointsChange:
        """Apply fog; draws each beam's distance from the strongest response to the fog's echo."""
        behind_m = _SPREAD_M * rng.beta(*_SPREAD_SHAPE, size=len(points))
        ranges_m = np.linalg.norm(points[:, :3].double().numpy(), axis=1)
        reflectances = clear_air_reflectances(points, ranges_m, self.lidar, rng)
        fading = np.exp(-2 * self.attenuation_per_m * ranges_m)
        response = fog_response(self.attenuation_per_m, self.lidar)
        fog_reflectances, fog_ranges_m = response.before(ranges_m, reflectances)
        is_fog = fog_reflectances > reflectances * fading
        fog_ranges_m = np.minimum(fog_ranges_m + behind_m, ranges_m)
        factors = np.where(is_fog, fog_ranges_m / np.maximum(ranges_m, 1e-9), 1.0)
        # A hard target's reading fades by its own value; a reading of 0 stays 0.
        read = points[:, 3].double().numpy() * fading
        read = np.where(is_fog, np.minimum(fog_reflectances, 1.0), read)
        received = np.where(is_fog, fog_reflectances, reflectances * fading)
        found = received >= faintest_power(self.lidar) * np.square(
            np.where(is_fog, fog_ranges_m, ranges_m)
        )
        foggy = points.clone()
        foggy[:, :3] *= torch.from_numpy(factors.astype(np.float32))[:, None]
        foggy[:, 3] = torch.from_numpy(read.astype(np.float32))
        rows = torch.from_numpy(np.flatnonzero(found))
        parameters = {
            "attenuation_per_m": self.attenuation_per_m,
            "num_lost": int(len(points) - found.sum()),
            "num_fog_echoes": int((found & is_fog).sum()),
        }
        return PointsChange(foggy[rows], rows, everywhere(sample), parameters)


class FogResponse(NamedTuple):
    """Strongest echo of the fog before a target, by the target's range."""

    step_m: float
    """Step between the ranges, from 0."""
    strongest: Float64[np.ndarray, " num_ranges"]
    """Largest response up to each range, for a target's constant of 1 [1/m^2]."""
    ranges_m: Float64[np.ndarray, " num_ranges"]
    """Range of that response."""
    backscatter_ratio: float
    """Ratio of the backscatter of the fog [1/m] and of a hard target."""

    def before(
        self,
        ranges_m: Float64[np.ndarray, " num_points"],
        reflectances: Float64[np.ndarray, " num_points"],
    ) -> tuple[Float64[np.ndarray, " num_points"], Float64[np.ndarray, " num_points"]]:
        """Compute the apparent reflectance of the fog before each target, and its range [m]."""
        places = np.minimum(ranges_m / self.step_m, len(self.strongest) - 1).astype(np.int64)
        apparent = reflectances * ranges_m**2 * self.backscatter_ratio * self.strongest[places]
        return apparent, self.ranges_m[places]


@lru_cache(maxsize=32)
def fog_response(attenuation_per_m: float, lidar: SpinningLidar) -> FogResponse:
    """Compute the response of fog alone for all ranges: Hahner et al. 2021, soft target.

    It is the integral, over the pulse, of its power, the attenuation along the path, the overlap of
    beam and receiver and 1 / range^2, by the midpoint rule.
    """
    ranges_m = np.arange(0, lidar.max_range_m, _STEP_M)
    times_s = (np.arange(_SLICES) + 0.5) / _SLICES * 2 * _PULSE_S
    pulse = np.sin(math.pi / (2 * _PULSE_S) * times_s) ** 2
    places_m = ranges_m[:, None] - _LIGHT_MPS * times_s / 2
    overlap = np.clip((places_m - lidar.min_range_m) / _CROSSOVER_M, 0, 1)
    shares = overlap / np.maximum(places_m, lidar.min_range_m) ** 2
    fading = np.exp(-2 * attenuation_per_m * np.maximum(places_m, 0))
    responses = (pulse * shares * fading).sum(axis=1) * (2 * _PULSE_S / _SLICES)
    strongest = np.maximum.accumulate(responses)
    is_new = np.diff(strongest, prepend=-1) > 0
    at = np.maximum.accumulate(np.where(is_new, np.arange(len(ranges_m)), 0))
    visibility_m = -math.log(VISIBLE_CONTRAST) / attenuation_per_m
    ratio = _BACKSCATTER / visibility_m / _TARGET_BACKSCATTER
    return FogResponse(_STEP_M, strongest, ranges_m[at], ratio)

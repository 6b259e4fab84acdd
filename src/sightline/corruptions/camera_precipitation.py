"""Rain and snow before a camera: a veil by all particles, and streaks of those that are near."""

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from jaxtyping import Float32, Float64

from sightline.corruptions.corruption import (
    CameraCorruption,
    Image,
    ImageChange,
    check_number,
    check_range,
    everywhere,
)
from sightline.corruptions.haze import airlight_level, to_levels, veil
from sightline.corruptions.precipitation import Precipitation, rain, snow
from sightline.corruptions.scene_depth import scene_ranges
from sightline.corruptions.streak_kernel import draw_streaks
from sightline.geometry.calibration import Calibration
from sightline.structures.sample import CameraLidarSample

_NEAREST_M = 0.4  # the windscreen or the hood keeps off what would be nearer
# What is beyond is part of the veil alone: drops too fast and flakes too small to be seen.
_RAIN_DRAWN_M = 8.0
_SNOW_DRAWN_M = 8.0
_MARGIN_PX = 40.0  # around the image, where streaks begin that end in it
_FAINTEST = 0.01  # opacity; fainter streaks are part of the veil
_SRGB_KNEE = np.float32(0.04045)


@dataclass(frozen=True, kw_only=True, slots=True)
class Exposure:
    """How the camera moves, and for how long its shutter is open."""

    time_s: float = 0.002
    """The longest exposure of KITTI's cameras."""
    speed_mps: float = 10.0
    """Of the car, straight ahead."""
    wind_mps: tuple[float, float] = (-3.0, 3.0)
    """To the right; drawn evenly."""

    def __post_init__(self) -> None:
        """Checks the ranges."""
        check_number("time_s", self.time_s, 0, 1)
        check_number("speed_mps", self.speed_mps, 0, 100)
        check_range("wind_mps", self.wind_mps, -100, 100)


@dataclass(frozen=True, kw_only=True, slots=True)
class _CameraPrecipitation(CameraCorruption):
    """What falls before the camera; see `fall`."""

    drawn_m: ClassVar[float]
    """Particles so near are drawn one by one."""

    rate_mm_per_h: float
    """Of water; of snow as if it were melted."""
    exposure: Exposure = Exposure()

    def __post_init__(self) -> None:
        """Checks the rate."""
        check_number("rate_mm_per_h", self.rate_mm_per_h, 0.01, 300)

    @abstractmethod
    def particles(self) -> Precipitation:
        """What falls."""

    def change_image(
        self, image: Image, sample: CameraLidarSample, rng: np.random.Generator
    ) -> ImageChange:
        """See `fall`."""
        change = fall(image, sample, self.particles(), self.exposure, rng, drawn_m=self.drawn_m)
        rate = {"rate_mm_per_h": self.rate_mm_per_h}
        return change._replace(parameters={**rate, **change.parameters})


@dataclass(frozen=True, kw_only=True, slots=True)
class CameraRain(_CameraPrecipitation):
    """Rain: a thin veil, and streaks of drops that fall at their final speed; see `fall`.

    Sizes are by Marshall and Palmer 1948, speeds by Atlas et al. 1973; a drop shows the light of
    its surroundings for as long as it covers a pixel, as Garg and Nayar 2007 found.
    """

    kind = "camera_rain"
    needs_calibration = True
    revision = 3
    drawn_m = _RAIN_DRAWN_M

    def particles(self) -> Precipitation:
        """Rain of that rate."""
        return rain(self.rate_mm_per_h)


@dataclass(frozen=True, kw_only=True, slots=True)
class CameraSnow(_CameraPrecipitation):
    """Snow: a veil, and flakes that sink at 1 m/s, sizes by Gunn and Marshall 1958; see `fall`."""

    kind = "camera_snow"
    needs_calibration = True
    revision = 3
    drawn_m = _SNOW_DRAWN_M

    def particles(self) -> Precipitation:
        """Snow of that rate."""
        return snow(self.rate_mm_per_h)


class Streaks(NamedTuple):
    """What particles leave in an image."""

    ends_px: Float64[np.ndarray, "num_streaks 4"]
    """x, y of the one end and of the other."""
    widths_px: Float64[np.ndarray, " num_streaks"]
    """At least 1."""
    opacities: Float64[np.ndarray, " num_streaks"]


def fall(
    image: Image,
    sample: CameraLidarSample,
    particles: Precipitation,
    exposure: Exposure,
    rng: np.random.Generator,
    *,
    drawn_m: float,
) -> ImageChange:
    """The image through rain or snow.

    What all particles together take and scatter is a veil (`haze.veil`); those up to `drawn_m` away
    are drawn one by one, over whatever is there, in the light that the air scatters. Shares of the
    exposure add up in light, not in levels as they are stored, which is what makes a bright drop
    before a dark wall seen though it covers a pixel for a twentieth of the time.
    """
    ranges_m, source = scene_ranges(sample)
    airlight = airlight_level(image)
    levels = veil(image, ranges_m, particles.extinction_per_m, airlight)
    wind_mps = rng.uniform(*exposure.wind_mps)
    streaks = draw_particles(
        particles, sample.calibration, sample.image_size, exposure, wind_mps, rng, drawn_m=drawn_m
    )
    light = to_light(levels)
    air = float(to_light(np.full(1, airlight, np.float32))[0])
    draw_streaks(light, streaks.ends_px, streaks.widths_px, streaks.opacities, air)
    said = {
        "wind_mps": wind_mps,
        "num_streaks": len(streaks.opacities),
        "airlight_levels": airlight,
        "distances_from": source,
    }
    return ImageChange(to_levels(from_light(light)), everywhere(sample), said)


def to_light(levels: Float32[np.ndarray, "*shape"]) -> Float32[np.ndarray, "*shape"]:
    """Light in [0, 1] that stored levels stand for: sRGB, IEC 61966-2-1."""
    shares = levels / np.float32(255)
    light: Float32[np.ndarray, "*shape"] = np.where(
        shares <= _SRGB_KNEE, shares / np.float32(12.92), ((shares + 0.055) / 1.055) ** 2.4
    ).astype(np.float32)
    return light


def from_light(light: Float32[np.ndarray, "*shape"]) -> Float32[np.ndarray, "*shape"]:
    """Levels that light in [0, 1] is stored as; the inverse of `to_light`."""
    shares = np.where(
        light <= _SRGB_KNEE / 12.92, light * np.float32(12.92), 1.055 * light ** (1 / 2.4) - 0.055
    )
    levels: Float32[np.ndarray, "*shape"] = (255 * shares).astype(np.float32)
    return levels


def draw_particles(
    particles: Precipitation,
    calibration: Calibration,
    image_size: tuple[int, int],
    exposure: Exposure,
    wind_mps: float,
    rng: np.random.Generator,
    *,
    drawn_m: float,
) -> Streaks:
    """Particles evenly spread in what the camera sees, as they move while it is exposed.

    The opacity is the share of the exposure in which the particle covers a pixel of its streak: the
    particle's area by the streak's, and so the same light in sum however it is spread.
    """
    height, width = image_size
    intrinsics = calibration.image_from_camera.numpy()
    focal_px = intrinsics[[0, 1], [0, 1]]
    # Of a tiny image 40 px are far more than it sees: they would hold billions of particles.
    margin_px = min(_MARGIN_PX, width, height)
    size_px = np.array([width, height]) + 2 * margin_px
    cube = drawn_m**3 - _NEAREST_M**3
    volume_m3 = float(np.prod(size_px / focal_px)) * cube / 3
    count = int(rng.poisson(particles.per_cubic_metre * volume_m3))
    depths_m = np.cbrt(_NEAREST_M**3 + cube * rng.random(count))
    pixels = size_px * rng.random((count, 2)) - margin_px - 0.5
    diameters_m = particles.draw_diameters_m(count, rng)
    sizes_px = float(np.sqrt(focal_px.prod())) * diameters_m / depths_m
    widths_px = np.maximum(sizes_px, 1)
    # Motion spreads a particle thinner: half of the raindrops would be too faint at rest.
    may_be_seen = math.pi / 4 * sizes_px**2 / (widths_px * widths_px) >= _FAINTEST
    depths_m, pixels, diameters_m = (each[may_be_seen] for each in (depths_m, pixels, diameters_m))
    sizes_px, widths_px = sizes_px[may_be_seen], widths_px[may_be_seen]
    places_m = (pixels - intrinsics[:2, 2]) / focal_px * depths_m[:, None]
    half_s = exposure.time_s / 2
    steps_m = half_s * np.stack(
        (np.full(len(depths_m), wind_mps), particles.speeds_mps(diameters_m)), axis=1
    )
    step_ahead_m = -half_s * exposure.speed_mps  # the car comes nearer
    ends = [
        intrinsics[:2, 2]
        + focal_px
        * (places_m + sign * steps_m)
        / np.maximum(depths_m + sign * step_ahead_m, _NEAREST_M / 2)[:, None]
        for sign in (-1, 1)
    ]
    lengths_px = np.linalg.norm(ends[1] - ends[0], axis=1)
    opacities = math.pi / 4 * sizes_px**2 / (widths_px * (lengths_px + widths_px))
    is_seen = opacities >= _FAINTEST
    return Streaks(np.concatenate(ends, axis=1)[is_seen], widths_px[is_seen], opacities[is_seen])

"""Rain and snow in a camera image: a veil from all particles, and streaks from near ones."""

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import Annotated, ClassVar, NamedTuple

import numpy as np
from jaxtyping import Float32, Float64

from sightline.corruptions.corruption import CameraCorruption, Image, ImageChange, everywhere
from sightline.corruptions.haze import airlight_level, to_levels, veil
from sightline.corruptions.precipitation import Precipitation, rain, snow
from sightline.corruptions.scene_depth import scene_ranges
from sightline.geometry.calibration import Calibration
from sightline.geometry.ranges import Within, check_ranges
from sightline.ops.compiled import compiled
from sightline.structures.sample import CameraLidarSample


@compiled
def draw_streaks(
    levels: Float32[np.ndarray, "channels height width"],
    ends_px: Float64[np.ndarray, "num_streaks 4"],
    widths_px: Float64[np.ndarray, " num_streaks"],
    opacities: Float64[np.ndarray, " num_streaks"],
    color: float,
) -> None:
    """Blend streaks over the image, in place.

    A streak covers points up to half its width from the line between its ends; a pixel with its
    centre within half a pixel of the rim has its covered share.
    """
    channels, height, width = levels.shape
    for streak in range(len(opacities)):
        x0, y0, x1, y1 = ends_px[streak]
        reach = widths_px[streak] / 2 + 0.5
        left = max(int(np.ceil(min(x0, x1) - reach)), 0)
        right = min(int(np.floor(max(x0, x1) + reach)), width - 1)
        top = max(int(np.ceil(min(y0, y1) - reach)), 0)
        bottom = min(int(np.floor(max(y0, y1) + reach)), height - 1)
        dx, dy = x1 - x0, y1 - y0
        square = dx * dx + dy * dy
        for row in range(top, bottom + 1):
            for column in range(left, right + 1):
                along = 0.0
                if square > 0:
                    along = ((column - x0) * dx + (row - y0) * dy) / square
                    along = min(max(along, 0.0), 1.0)
                off_x, off_y = column - x0 - along * dx, row - y0 - along * dy
                covered = min(reach - np.sqrt(off_x * off_x + off_y * off_y), 1.0)
                if covered > 0:
                    weight = opacities[streak] * covered
                    for channel in range(channels):
                        level = levels[channel, row, column]
                        levels[channel, row, column] = level + weight * (color - level)


_NEAREST_M = 0.4  # the windscreen or the hood keeps nearer particles away
# Particles beyond contribute only to the veil: drops too fast and flakes too small to be visible.
_RAIN_DRAWN_M = 8.0
_SNOW_DRAWN_M = 8.0
_MARGIN_PX = 40.0  # around the image, where streaks begin that end in it
_FAINTEST = 0.01  # opacity; fainter streaks are part of the veil
_SRGB_KNEE = np.float32(0.04045)


@dataclass(frozen=True, kw_only=True, slots=True)
class Exposure:
    """Camera motion and exposure time."""

    time_s: Annotated[float, Within(0, 1)] = 0.002
    """Exposure time; the default is the longest of KITTI's cameras."""
    speed_mps: Annotated[float, Within(0, 100)] = 10.0
    """Speed of the car, straight ahead."""
    wind_mps: Annotated[tuple[float, float], Within(-100, 100)] = (-3.0, 3.0)
    """Wind to the right; uniform distribution."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        check_ranges(self)


@dataclass(frozen=True, kw_only=True, slots=True)
class _CameraPrecipitation(CameraCorruption):
    """Precipitation in a camera image; see `fall`."""

    drawn_m: ClassVar[float]
    """Maximum distance of individually drawn particles."""

    rate_mm_per_h: Annotated[float, Within(0.01, 300)]
    """Water rate; for snow, of the melted water."""
    exposure: Exposure = Exposure()

    @abstractmethod
    def particles(self) -> Precipitation:
        """Particles of the precipitation."""

    def change_image(
        self, image: Image, sample: CameraLidarSample, rng: np.random.Generator
    ) -> ImageChange:
        """Apply `fall`."""
        change = fall(image, sample, self.particles(), self.exposure, rng, drawn_m=self.drawn_m)
        rate = {"rate_mm_per_h": self.rate_mm_per_h}
        return change._replace(parameters={**rate, **change.parameters})


@dataclass(frozen=True, kw_only=True, slots=True)
class CameraRain(_CameraPrecipitation):
    """Rain: a thin veil, and streaks of drops at terminal speed; see `fall`.

    Sizes are by Marshall and Palmer 1948, speeds by Atlas et al. 1973; a drop shows the light of
    its surroundings while it covers a pixel, as Garg and Nayar 2007 found.
    """

    kind = "camera_rain"
    needs_calibration = True
    revision = 3
    drawn_m = _RAIN_DRAWN_M

    def particles(self) -> Precipitation:
        """Rain at this rate."""
        return rain(self.rate_mm_per_h)


@dataclass(frozen=True, kw_only=True, slots=True)
class CameraSnow(_CameraPrecipitation):
    """Snow: a veil, and flakes falling at 1 m/s, sizes by Gunn and Marshall 1958; see `fall`."""

    kind = "camera_snow"
    needs_calibration = True
    revision = 3
    drawn_m = _SNOW_DRAWN_M

    def particles(self) -> Precipitation:
        """Snow at this rate."""
        return snow(self.rate_mm_per_h)


class Streaks(NamedTuple):
    """Streaks of particles in an image."""

    ends_px: Float64[np.ndarray, "num_streaks 4"]
    """x, y of both ends."""
    widths_px: Float64[np.ndarray, " num_streaks"]
    """Widths of at least 1."""
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
    """Render rain or snow into an image.

    All particles together cause a veil by extinction and scattering (`haze.veil`). Particles up to
    `drawn_m` away are drawn one by one, over everything else, in the scattered light. Shares of the
    exposure are added in linear light, not in stored levels; otherwise a bright drop before a dark
    wall would be invisible, as it covers a pixel for a twentieth of the time.
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
    parameters = {
        "wind_mps": wind_mps,
        "num_streaks": len(streaks.opacities),
        "airlight_levels": airlight,
        "distances_from": source,
    }
    return ImageChange(to_levels(from_light(light)), everywhere(sample), parameters)


def to_light(levels: Float32[np.ndarray, "*shape"]) -> Float32[np.ndarray, "*shape"]:
    """Convert stored levels to linear light in [0, 1]: sRGB, IEC 61966-2-1."""
    shares = levels / np.float32(255)
    light: Float32[np.ndarray, "*shape"] = np.where(
        shares <= _SRGB_KNEE, shares / np.float32(12.92), ((shares + 0.055) / 1.055) ** 2.4
    ).astype(np.float32)
    return light


def from_light(light: Float32[np.ndarray, "*shape"]) -> Float32[np.ndarray, "*shape"]:
    """Convert linear light in [0, 1] to stored levels; the inverse of `to_light`."""
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
    """Draw particles evenly spread in the camera's view, with their motion during the exposure.

    The opacity is the share of the exposure in which the particle covers a pixel of its streak: the
    particle's area over the streak's area. The total light is thus independent of the streak's
    length.
    """
    height, width = image_size
    intrinsics = calibration.image_from_camera.numpy()
    focal_px = intrinsics[[0, 1], [0, 1]]
    # In a tiny image, 40 px are far more than its view: they would hold billions of particles.
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
    # Motion spreads a particle's light: half of the raindrops would be too faint even at rest.
    may_be_seen = math.pi / 4 * sizes_px**2 / (widths_px * widths_px) >= _FAINTEST
    depths_m, pixels, diameters_m = (each[may_be_seen] for each in (depths_m, pixels, diameters_m))
    sizes_px, widths_px = sizes_px[may_be_seen], widths_px[may_be_seen]
    places_m = (pixels - intrinsics[:2, 2]) / focal_px * depths_m[:, None]
    half_s = exposure.time_s / 2
    steps_m = half_s * np.stack(
        (np.full(len(depths_m), wind_mps), particles.speeds_mps(diameters_m)), axis=1
    )
    step_ahead_m = -half_s * exposure.speed_mps  # the car approaches
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

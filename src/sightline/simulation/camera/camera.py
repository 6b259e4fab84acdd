"""Camera renderer: image, dense depth and the actor of each pixel, and the file's losses."""

import math
from dataclasses import dataclass, field, replace
from typing import Annotated, Final, Literal, TypeVar, cast

import cv2
import numpy as np
from jaxtyping import Float32, Int32, UInt8, UInt16

from sightline.data.formats.kitti_calibration import CalibrationMatrices
from sightline.geometry.choices import check_choices
from sightline.geometry.kitti_mount import KITTI_LIDAR_HEIGHT_M
from sightline.geometry.ranges import Within, check_ranges
from sightline.ops.compiled import compiled
from sightline.simulation.camera.radiance import pixel_radiance
from sightline.simulation.camera.samples import (
    RollingView,
    Samples,
    View,
    add_edge_samples,
    camera_view,
    pixel_samples,
)
from sightline.simulation.camera.shading import LitWorld, lit_world
from sightline.simulation.camera.windscreen import Dirt, seen_through
from sightline.simulation.rays.raycast import Raycaster
from sightline.simulation.scene import Light, Scene
from sightline.simulation.settings import KITTI_IMAGE_SIZE

Image = TypeVar("Image", Float32[np.ndarray, "h w 3"], UInt16[np.ndarray, "h w 3"])

_AMPLIFICATION: Final = (2.6, 1.0, 3.6)
"""Amplification of red, green and blue behind the photosites; it increases noise."""
_SHOULDER: Final = 0.15
_FULL: Final = 65535  # value of a full photosite in the demosaicing
_REC709: Final = (0.2126, 0.7152, 0.0722)
_METERED_FROM: Final = 0.45  # share of the image, from its top, excluded from metering: mostly sky


@dataclass(frozen=True, kw_only=True, slots=True)
class SensorConfig:
    """Response of sensor and lens."""

    sensitivity: Annotated[float, Within(0)] = 3.0
    """Share of a photosite filled by one unit of radiance at an exposure of 1."""
    metering: Annotated[float, Within(0, 1)] = 0.7
    """Weight of the scene's brightness in the exposure; 0: only the light's exposure, 1: full
    metering."""
    metering_limit: Annotated[float, Within(1)] = 2.5
    """Maximum factor by which metering raises or lowers the light's exposure."""
    target_level: Annotated[float, Within(0)] = 0.32
    """Target of metering: mean exposed radiance below the horizon; 1 fills a photosite."""
    vignette: Annotated[float, Within(0)] = 0.16  # share of the light lost in the corners
    lens_blur_px: Annotated[float, Within(0)] = 0.4
    """Standard deviation of the blur in front of the colour mosaic."""
    resampling_blur_px: Annotated[float, Within(0)] = 0.4
    """Standard deviation of the blur behind it, from rectification of the image."""
    photon_noise: Annotated[float, Within(0)] = 0.025
    """Standard deviation of a full photosite's noise, as a share; noise grows with the square root
    of the light."""
    read_noise: Annotated[float, Within(0)] = 0.0016
    """Standard deviation of the noise in the dark, as a share of a full photosite."""
    gamma: float = 1.08  # exponent of the tone curve; KITTI's cameras are close to linear

    def __post_init__(self) -> None:
        """Check the ranges."""
        if not 0 < self.gamma < math.inf:
            raise ValueError(f"gamma must be finite and positive, got {self.gamma}")
        check_ranges(self)


def sensor_image(
    radiance: Float32[np.ndarray, "height width 3"],
    exposure: float,
    *,
    rng: np.random.Generator,
    config: SensorConfig,
) -> UInt8[np.ndarray, "height width 3"]:
    """Compute a sensor's image of linear RGB radiance; only the noise depends on `rng`."""
    height, width, _ = radiance.shape
    exposed = radiance * np.float32(_gain(radiance, exposure, config))
    exposed *= _vignette(height, width, config.vignette)[..., None]
    exposed = _blurred(exposed, config.lens_blur_px)
    noise = rng.standard_normal((height, width), dtype=np.float32)
    mosaic = np.empty((height, width), np.uint16)
    _count_photons(exposed, noise, config.photon_noise, config.read_noise, mosaic)
    # OpenCV names the pattern by its second row and column: this one has red first.
    counted = cv2.cvtColor(mosaic, cv2.COLOR_BayerBG2RGB_EA)
    return np.asarray(_tone_curve(config.gamma)[_blurred(counted, config.resampling_blur_px)])


def _blurred(image: Image, sigma_px: float) -> Image:
    if sigma_px <= 0:
        return image
    # For the blur of a sharp lens, a kernel wider than 3 x 3 would only add zeros.
    size = 2 * math.ceil(1.7 * sigma_px) + 1
    return cast(
        "Image", cv2.GaussianBlur(image, (size, size), sigma_px, borderType=cv2.BORDER_REFLECT)
    )


def _gain(radiance: Float32[np.ndarray, "h w 3"], exposure: float, config: SensorConfig) -> float:
    """Compute photosite shares per unit of radiance, from the light's exposure and metering."""
    exposure *= config.sensitivity
    street = radiance[int(_METERED_FROM * len(radiance)) :: 4, ::4]
    # Radiance is clipped at a full photosite, so that saturated areas do not darken the rest.
    seen = np.minimum(street @ np.array(_REC709, np.float32) * exposure, 1.0)
    level = float(np.exp(np.log(np.maximum(seen, 1e-3)).mean()))
    factor = (config.target_level / level) ** config.metering
    return float(exposure * min(max(factor, 1 / config.metering_limit), config.metering_limit))


def _vignette(height: int, width: int, loss: float) -> Float32[np.ndarray, "height width"]:
    y, x = np.ogrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    # Wide images are cropped from a round image circle, so the sides lose more than top and bottom.
    squared = 0.85 * x**2 + 0.15 * y**2
    return (1 - loss * squared).astype(np.float32)


@compiled
def _count_photons(
    exposed: Float32[np.ndarray, "height width 3"],
    noise: Float32[np.ndarray, "height width"],
    photon_noise: float,
    read_noise: float,
    mosaic: UInt16[np.ndarray, "height width"],
) -> None:
    """Record one colour per photosite, red first, with noise that grows with the light."""
    for row in range(mosaic.shape[0]):
        for column in range(mosaic.shape[1]):
            color = (row & 1) + (column & 1)
            light = max(exposed[row, column, color], np.float32(0.0))
            gain = _AMPLIFICATION[color]
            variance = gain * photon_noise * photon_noise * light + (gain * read_noise) ** 2
            counted = light + noise[row, column] * np.sqrt(variance)
            mosaic[row, column] = np.uint16(_FULL * min(max(counted, 0.0), 1.0) + 0.5)


def _tone_curve(gamma: float) -> UInt8[np.ndarray, " levels"]:
    """Compute the value of every level: a power, with a shoulder that compresses highlights."""
    encoded = (np.arange(_FULL + 1) / _FULL) ** (1 / gamma)
    return (255 * (encoded + _SHOULDER * encoded * (1 - encoded)) + 0.5).astype(np.uint8)


SKY: Final = -2  # owner of a pixel that shows no surface
STREET: Final = -1  # owner of a pixel that shows a surface of no actor

_SUBPIXEL_OFFSETS: Final = ((-0.125, -0.375), (0.375, -0.125), (0.125, 0.375), (-0.375, 0.125))
_BRIGHTEST: Final = 3.0
"""Share of a photosite at which a sample is clipped, so that no glint outweighs its pixel."""


@dataclass(frozen=True, kw_only=True, slots=True)
class CameraConfig:
    """Camera mount and rendering quality."""

    picture: bool = True  # whether to render the image as well as its ground truth
    samples_per_pixel: Literal[1, 4] = (
        1  # samples per pixel: 1, with more at edges, or 4 everywhere
    )
    ambient_stride: Annotated[int, Within(1)] = 3
    """Step [px] of the grid on which ambient light is gathered."""
    ambient_rays: Annotated[int, Within(1)] = 4  # ambient rays per grid point
    lidar_height_m: Annotated[float, Within(-100, 100)] = KITTI_LIDAR_HEIGHT_M
    """Height of the LiDAR, the calibration's reference frame, above the ego's footprint."""
    sensor: SensorConfig = field(default_factory=SensorConfig)

    def __post_init__(self) -> None:
        """Check the values."""
        check_choices(self)
        check_ranges(self)


@dataclass(frozen=True, kw_only=True, slots=True)
class CameraFrame:
    """Camera image of one moment, with its ground truth."""

    image: UInt8[np.ndarray, "height width 3"] | None  # RGB; None without `CameraConfig.picture`
    depth_m: Float32[np.ndarray, "height width"]
    """Depth along the optical axis at the centre of each pixel; 0 = sky."""
    owners: Int32[np.ndarray, "height width"]
    """Index of the actor at the centre of each pixel, STREET or SKY."""


def render_camera(
    scene: Scene,
    calibration: CalibrationMatrices,
    image_size: tuple[int, int] = KITTI_IMAGE_SIZE,
    *,
    rng: np.random.Generator,
    config: CameraConfig | None = None,
    raycaster: Raycaster | None = None,
    view: View | RollingView | None = None,
    dirt: Dirt | None = None,
) -> CameraFrame:
    """Render a scene at (height, width).

    Depth and owners do not depend on the samples per pixel; only the sensor's noise in the image is
    drawn from `rng`. A `raycaster` over the scene's mesh saves building one. Without a `view`, it
    is the calibration's from the scene's ego. `dirt` lies on the windscreen.
    """
    config = config or CameraConfig()
    world = lit_world(scene, raycaster or Raycaster(scene.mesh))
    view = view or camera_view(calibration, scene.ego, config.lidar_height_m)
    centers = pixel_samples(world, view, image_size, (0.0, 0.0))
    truth = _truth(centers, scene.owners)
    if not config.picture:
        return truth
    if config.samples_per_pixel == 1:
        samples = add_edge_samples(world, view, centers, scene.owners)
        radiance = _radiance(world, samples, view, scene.light, config)
    else:
        radiance = np.zeros((*image_size, 3), np.float32)
        for offset in _SUBPIXEL_OFFSETS:
            samples = pixel_samples(world, view, image_size, offset)
            radiance += _radiance(world, samples, view, scene.light, config)
        radiance /= np.float32(len(_SUBPIXEL_OFFSETS))
    if dirt is not None:
        radiance = seen_through(dirt, radiance)
    image = sensor_image(radiance, scene.light.exposure, rng=rng, config=config.sensor)
    return replace(truth, image=image)


def _truth(centers: Samples, face_owners: Int32[np.ndarray, " num_faces"]) -> CameraFrame:
    found = centers.hits.faces >= 0
    owners = np.full(len(found), SKY, np.int32)
    owners[found] = face_owners[centers.hits.faces[found]]
    depth_m = np.where(found, centers.hits.distances, np.float32(0))
    size = centers.image_size
    return CameraFrame(image=None, depth_m=depth_m.reshape(size), owners=owners.reshape(size))


def _radiance(
    world: LitWorld,
    samples: Samples,
    view: View | RollingView,
    light: Light,
    config: CameraConfig,
) -> Float32[np.ndarray, "height width 3"]:
    return pixel_radiance(
        world,
        samples,
        view.pixel_angle,
        ambient_stride=config.ambient_stride,
        ambient_rays=config.ambient_rays,
        brightest=_BRIGHTEST / (config.sensor.sensitivity * light.exposure),
    )


def stored_image(
    image: UInt8[np.ndarray, "height width 3"],
    white_balance: tuple[float, float, float],
    jpeg_quality: int,
) -> UInt8[np.ndarray, "height width 3"]:
    """Apply factors on red, green and blue, and the loss of a JPEG; a quality of 100 loses none.

    The factors fade towards full values, so that what is overexposed stays white.
    """
    if white_balance != (1.0, 1.0, 1.0):
        level = np.arange(256)[:, None]
        factors = np.array(white_balance)
        levels = level * (factors + (1 - factors) * (level / 255) ** 4)
        table = levels.clip(0, 255).round().astype(np.uint8)
        image = np.stack([table[:, band][image[..., band]] for band in range(3)], axis=-1)
    if jpeg_quality >= 100:
        return image
    _, packed = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality])
    unpacked = cv2.imdecode(packed, cv2.IMREAD_COLOR)
    assert unpacked is not None, "OpenCV has just written it"
    return np.ascontiguousarray(unpacked[..., ::-1]).astype(np.uint8, copy=False)

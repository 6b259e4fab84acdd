"""Camera renderer: image, dense depth and the actor of each pixel."""

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from jaxtyping import Float32, Int32, UInt8

from sightline.data.calibration_text import CalibrationMatrices
from sightline.geometry.kitti_mount import KITTI_LIDAR_HEIGHT_M
from sightline.simulation.camera_radiance import pixel_radiance
from sightline.simulation.camera_rays import (
    Samples,
    View,
    camera_view,
    pixel_samples,
    with_edge_samples,
)
from sightline.simulation.raycast import Raycaster
from sightline.simulation.scene import Light, Scene
from sightline.simulation.sensor_image import SensorConfig, sensor_image
from sightline.simulation.settings import KITTI_IMAGE_SIZE
from sightline.simulation.shading import LitWorld, lit_world

SKY: Final = -2
"""Owner of a pixel that shows no surface."""
STREET: Final = -1
"""Owner of a pixel that shows a surface of no actor."""

_OFFSETS_OF_FOUR: Final = ((-0.125, -0.375), (0.375, -0.125), (0.125, 0.375), (-0.375, 0.125))
_BRIGHTEST: Final = 3.0
"""Share of a photosite at which a sample is clipped, so that no glint outweighs its pixel."""


@dataclass(frozen=True, kw_only=True, slots=True)
class CameraConfig:
    """Camera mount and rendering quality."""

    picture: bool = True
    """Whether to render the image as well as its ground truth."""
    samples_per_pixel: int = 1
    """Samples per pixel: 1, with more at edges, or 4 everywhere."""
    ambient_stride: int = 3
    """Step [px] of the grid on which ambient light is gathered."""
    ambient_rays: int = 4
    """Ambient rays per grid point."""
    lidar_height_m: float = KITTI_LIDAR_HEIGHT_M
    """Height of the LiDAR, the calibration's reference frame, above the ego's footprint."""
    sensor: SensorConfig = field(default_factory=SensorConfig)

    def __post_init__(self) -> None:
        """Check the values."""
        if self.samples_per_pixel not in (1, 4):
            raise ValueError(f"samples_per_pixel must be 1 or 4, got {self.samples_per_pixel}")
        if self.ambient_stride < 1 or self.ambient_rays < 1:
            raise ValueError(
                "ambient_stride and ambient_rays must be at least 1, got "
                f"{self.ambient_stride} and {self.ambient_rays}"
            )


@dataclass(frozen=True, kw_only=True, slots=True)
class CameraFrame:
    """Camera image of one moment, with its ground truth."""

    image: UInt8[np.ndarray, "height width 3"] | None
    """RGB; None without `CameraConfig.picture`."""
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
) -> CameraFrame:
    """Render a scene at (height, width).

    Depth and owners do not depend on the samples per pixel; only the sensor's noise in the image is
    drawn from `rng`. A `raycaster` over the scene's mesh saves building one.
    """
    config = config or CameraConfig()
    world = lit_world(scene, raycaster or Raycaster(scene.mesh))
    view = camera_view(calibration, scene.ego, config.lidar_height_m)
    centers = pixel_samples(world, view, image_size, (0.0, 0.0))
    truth = _truth(centers, scene.owners)
    if not config.picture:
        return truth
    if config.samples_per_pixel == 1:
        samples = with_edge_samples(world, view, centers, scene.owners)
        radiance = _radiance(world, samples, view, scene.light, config)
    else:
        radiance = np.zeros((*image_size, 3), np.float32)
        for offset in _OFFSETS_OF_FOUR:
            samples = pixel_samples(world, view, image_size, offset)
            radiance += _radiance(world, samples, view, scene.light, config)
        radiance /= np.float32(len(_OFFSETS_OF_FOUR))
    image = sensor_image(radiance, scene.light.exposure, rng=rng, config=config.sensor)
    return replace(truth, image=image)


def _truth(centers: Samples, owners_of_faces: Int32[np.ndarray, " num_faces"]) -> CameraFrame:
    found = centers.hits.faces >= 0
    owners = np.full(len(found), SKY, np.int32)
    owners[found] = owners_of_faces[centers.hits.faces[found]]
    depth_m = np.where(found, centers.hits.distances, np.float32(0))
    size = centers.image_size
    return CameraFrame(image=None, depth_m=depth_m.reshape(size), owners=owners.reshape(size))


def _radiance(
    world: LitWorld, samples: Samples, view: View, light: Light, config: CameraConfig
) -> Float32[np.ndarray, "height width 3"]:
    return pixel_radiance(
        world,
        samples,
        view.pixel_angle,
        ambient_stride=config.ambient_stride,
        ambient_rays=config.ambient_rays,
        brightest=_BRIGHTEST / (config.sensor.sensitivity * light.exposure),
    )

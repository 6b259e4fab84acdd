"""Simulation of one moment of a drive: all sensors and labels."""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float32, Float64, Int32, UInt8

from sightline.data.formats.kitti_calibration import CalibrationMatrices
from sightline.data.formats.kitti_labels import KittiObjects
from sightline.data.formats.pixels import resized_and_cropped
from sightline.geometry.road_height import LidarPose
from sightline.simulation.bodies.own_car import bonnet, own_car
from sightline.simulation.camera.camera import (
    CameraConfig,
    SensorConfig,
    render_camera,
    stored_image,
)
from sightline.simulation.camera.samples import RollingView, View, camera_view
from sightline.simulation.camera.windscreen import Dirt, draw_dirt
from sightline.simulation.labels import label_frame
from sightline.simulation.lidar import mounted, take_sweep
from sightline.simulation.lidar_config import LIDARS, LidarConfig
from sightline.simulation.random_rigs import random_rig
from sightline.simulation.rays.raycast import Raycaster
from sightline.simulation.rig_sensors import Sensors, mount
from sightline.simulation.rigs import RIG_NAMES, CameraRig, Rig, named_rig
from sightline.simulation.scene import Mesh, Scene, Street, world_from_footprint
from sightline.simulation.settings import KITTI_FOCAL_PX, KITTI_IMAGE_SIZE, SimulationConfig
from sightline.simulation.street import make_street

FRAME_S = 0.1  # interval between two frames of a sequence: KITTI's 10 Hz

_IMAGE_FROM_CAMERA = (
    (KITTI_FOCAL_PX, 0.0, 609.5593, 44.85728),
    (0.0, KITTI_FOCAL_PX, 172.854, 0.2163791),
    (0.0, 0.0, 1.0, 0.002745884),
)
# KITTI's mount: camera 0 is 0.27 m ahead of the LiDAR and 0.08 m below it.
_CAMERA_FROM_LIDAR = (
    (0.0, -1.0, 0.0, 0.0), (0.0, 0.0, -1.0, -0.08), (1.0, 0.0, 0.0, -0.27), (0.0, 0.0, 0.0, 1.0),
)  # fmt: skip
# These separate draws from those of streets and sensors.
_RIG_STREAM, _BONNET_STREAM, _DIRT_STREAM, _OWN_CAR_STREAM = 38, 39, 40, 41
# Other cameras than KITTI's adapt to shaded streets and to dusk.
_RIG_SENSOR: Final = SensorConfig(metering_limit=4.5)
_MAX_DEPTH_M = 250.0  # a 16-bit depth map ends at 256 m


def calibration_of(config: SimulationConfig) -> CalibrationMatrices:
    """Build the calibration of KITTI's camera 2 at the chosen size and focal length."""
    kitti = CalibrationMatrices(
        image_from_camera=np.array(_IMAGE_FROM_CAMERA),
        camera_from_lidar=np.array(_CAMERA_FROM_LIDAR),
    )
    scale = config.focal_px / KITTI_FOCAL_PX
    height, width = (scale * size for size in KITTI_IMAGE_SIZE)
    x_min, y_min = (width - config.image_size[1]) / 2, height - config.image_size[0]
    return resized_and_cropped(kitti, scale, round(x_min), round(y_min))


def lidar_of(config: SimulationConfig) -> LidarConfig:
    """Build the configuration of the chosen LiDAR."""
    return replace(LIDARS[config.lidar], rolling_shutter=config.rolling_shutter)


def rig_of(config: SimulationConfig, drive: int) -> Rig | None:
    """Choose the rig of a drive, which is a single frame if `sequence_length` is 1; None: KITTI's.

    Random rigs depend on the seed and the drive alone.
    """
    if config.rig == "random":
        return random_rig(np.random.default_rng([config.seed, drive, _RIG_STREAM]))
    if config.rig == "named":
        return named_rig(RIG_NAMES[drive % len(RIG_NAMES)])
    return config.rig


def sensors_of(config: SimulationConfig, drive: int) -> Sensors:
    """Mount the sensors of a drive."""
    rig = rig_of(config, drive)
    if rig is None:
        return Sensors(
            image_size=config.image_size,
            level_calibration=calibration_of(config),
            lidar=lidar_of(config),
        )
    sensors = mount(rig)
    return replace(sensors, lidar=replace(sensors.lidar, rolling_shutter=config.rolling_shutter))


@dataclass(frozen=True, kw_only=True, slots=True)
class SimulatedFrame:
    """All data of a frame that is written to files; `dataset.sample_of` converts it to a sample."""

    sample_id: str
    calibration: CalibrationMatrices
    image: UInt8[np.ndarray, "height width 3"] | None  # RGB; None without a camera
    points: Float32[np.ndarray, "num_points 4"]
    """A whole turn of the LiDAR: x, y, z [m] in its frame, reflectance in [0, 1]."""
    objects: KittiObjects
    visible_boxes: Float64[np.ndarray, "num_objects 4"]
    """x_min, y_min, x_max, y_max [px] of each object's visible pixels; NaN for DontCare. The
    labels' own boxes are KITTI's: of the whole object, hidden parts included."""
    depth_m: Float32[np.ndarray, "height width"]
    """Depth along the optical axis at every pixel; 0 = the sky, or too far for a depth map."""
    instances: Int32[np.ndarray, "height width"]
    """1 + the label row of each pixel's object; 0 for all other pixels."""
    world_from_lidar: Float64[np.ndarray, "4 4"]
    time_s: float  # time since the drive's first frame
    lidar_pose: LidarPose | None = None
    """Mount of a rig's LiDAR over the road, in the calibration file; None: KITTI's."""

    @property
    def image_size(self) -> tuple[int, int]:
        """Height, width [px]."""
        return self.depth_m.shape[0], self.depth_m.shape[1]


@runtime_checkable  # for beartype, which checks arguments under pytest
class StreetMaker(Protocol):
    """Maker of random streets; a module-level function, so that worker processes can import it."""

    __module__: str
    __qualname__: str

    def __call__(
        self,
        rng: np.random.Generator,
        *,
        duration_s: float,
        hard: bool = False,
        hard_negatives: bool = False,
        varied: bool = False,
    ) -> Street:
        """Make a street with traffic defined for `duration_s`.

        `hard`, `hard_negatives` and `varied` are passed only if `SimulationConfig` sets them: a
        maker of one kind of streets needs no such argument, and then rejects the setting with a
        TypeError.
        """

    def __hash__(self) -> int:
        """Hash of the function, by which `simulate_street` caches the last street."""


def simulate_frame(
    config: SimulationConfig, index: int, streets: StreetMaker = make_street
) -> SimulatedFrame:
    """Simulate frame `index`; the same arguments give the same bytes, in any order and anywhere."""
    drive, step = divmod(index, config.sequence_length)
    street = simulate_street(config, drive, streets)
    time_s = step * FRAME_S
    sensors = sensors_of(config, drive)
    scene = street.snapshot(time_s)
    if sensors.camera is not None and sensors.camera.bonnet_m:
        scene = _with_bonnet(scene, sensors.camera, config, drive)
    raycaster = Raycaster(scene.mesh)
    camera_rng, lidar_rng = (
        np.random.default_rng(child)
        for child in np.random.SeedSequence([config.seed, drive, step]).spawn(2)
    )
    lidar = sensors.lidar
    camera = CameraConfig(
        picture=config.camera,
        samples_per_pixel=config.samples_per_pixel,
        lidar_height_m=lidar.height_m,
        sensor=SensorConfig() if sensors.camera is None else _RIG_SENSOR,
    )
    view = _view(sensors, street, time_s)
    picture = render_camera(
        scene,
        sensors.level_calibration,
        sensors.image_size,
        rng=camera_rng,
        config=camera,
        raycaster=raycaster,
        view=view,
        dirt=_dirt(sensors, config, drive),
    )
    points = take_sweep(
        scene,
        raycaster,
        rng=lidar_rng,
        config=lidar,
        ego=street.ego,
        time_s=time_s,
        own_car=_own_car(sensors, config, drive),
    )
    labels = label_frame(scene, picture.owners, sensors.level_calibration, lidar.height_m, view)
    rows = np.zeros(len(scene.actors) + 2, dtype=np.int32)  # STREET and SKY index the last two
    labelled = labels.actors >= 0
    rows[labels.actors[labelled]] = 1 + np.flatnonzero(labelled)
    return SimulatedFrame(
        sample_id=f"{index:06d}" if config.sequence_length == 1 else f"{step:010d}",
        calibration=sensors.calibration,
        image=_stored(picture.image, sensors.camera),
        points=points,
        objects=labels.objects,
        visible_boxes=labels.visible_boxes,
        depth_m=np.where(picture.depth_m <= _MAX_DEPTH_M, picture.depth_m, np.float32(0)),
        instances=rows[picture.owners],
        world_from_lidar=mounted(world_from_footprint(scene.ego, lidar.height_m), lidar),
        time_s=time_s,
        lidar_pose=sensors.lidar_pose,
    )


def _view(sensors: Sensors, street: Street, time_s: float) -> View | RollingView:
    """Compute the camera's view; one with a rolling exposure moves with the ego meanwhile."""
    calibration, height_m = sensors.level_calibration, sensors.lidar.height_m
    readout_s = 0.0 if sensors.camera is None else sensors.camera.readout_ms / 1000
    if not readout_s:
        return camera_view(calibration, street.ego.at(time_s), height_m)
    first, last = (
        camera_view(calibration, street.ego.at(time_s + shift * readout_s), height_m)
        for shift in (-0.5, 0.5)
    )
    return RollingView(first=first, last=last, num_rows=sensors.image_size[0])


def _dirt(sensors: Sensors, config: SimulationConfig, drive: int) -> Dirt | None:
    """Draw the dirt on the windscreen, the same for a whole drive."""
    if sensors.camera is None or not sensors.camera.dirt:
        return None
    rng = np.random.default_rng([config.seed, drive, _DIRT_STREAM])
    return draw_dirt(rng, sensors.image_size, sensors.camera.dirt)


def _own_car(sensors: Sensors, config: SimulationConfig, drive: int) -> Mesh | None:
    """Build the car below the LiDAR, if its body is in view."""
    if not sensors.roof_m:
        return None
    return own_car(np.random.default_rng([config.seed, drive, _OWN_CAR_STREAM]), sensors.roof_m)


def _with_bonnet(scene: Scene, camera: CameraRig, config: SimulationConfig, drive: int) -> Scene:
    """Add the bonnet of the own car, which belongs to no actor, in front of the camera."""
    rng = np.random.default_rng([config.seed, drive, _BONNET_STREAM])
    part = bonnet(
        rng, ahead_m=camera.ahead_m, left_m=camera.left_m, height_m=camera.bonnet_m
    ).placed(scene.ego)
    owners = np.concatenate((np.full(len(part.faces), -1, np.int32), scene.owners))
    return replace(scene, mesh=Mesh.joined([part, scene.mesh]), owners=owners)


def _stored(
    image: UInt8[np.ndarray, "height width 3"] | None, camera: CameraRig | None
) -> UInt8[np.ndarray, "height width 3"] | None:
    if image is None or camera is None:
        return image
    return stored_image(image, camera.white_balance, camera.jpeg_quality)


@lru_cache(maxsize=1)  # the frames of a drive come one after the other
def simulate_street(
    config: SimulationConfig, drive: int, streets: StreetMaker = make_street
) -> Street:
    """Make the street of a drive, which is a single frame if `sequence_length` is 1."""
    rng = np.random.default_rng(np.random.SeedSequence([config.seed, drive]))
    duration_s = (config.sequence_length - 1) * FRAME_S
    special = {
        "hard": config.hard,
        "hard_negatives": config.hard_negatives,
        "varied": config.varied,
    }
    given = {name: True for name, is_set in special.items() if is_set}
    return streets(rng, duration_s=duration_s, **given)


def simulate_course(
    config: SimulationConfig, drive: int, length: int, streets: StreetMaker = make_street
) -> Float64[np.ndarray, "length 4 4"]:
    """Compute `world_from_lidar` of the first `length` frames of a drive."""
    ego = simulate_street(config, drive, streets).ego
    lidar = sensors_of(config, drive).lidar
    return np.stack(
        [
            mounted(world_from_footprint(ego.at(step * FRAME_S), lidar.height_m), lidar)
            for step in range(length)
        ]
    )

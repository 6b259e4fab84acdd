"""Sensors of a rig: calibration and LiDAR, as the simulator needs them."""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np
from jaxtyping import Float64

from sightline.data.formats.kitti_calibration import CalibrationMatrices
from sightline.geometry.road_height import LidarPose
from sightline.geometry.tilt import Tilt
from sightline.simulation.camera.samples import LEVEL_CAMERA_AXES
from sightline.simulation.lidar_config import LIDARS, BlindSector, Laser, LidarConfig
from sightline.simulation.rigs import CameraRig, LidarRig, Rig

_REACH_SHARE: Final = 0.9  # of the largest range
_OWN_CAR_RANGE_M: Final = 0.4
"""Smallest range of a LiDAR that returns points of its own car."""
_KITTI: Final = LidarConfig(lasers=(Laser(elevation_deg=0.0),))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Sensors:
    """Camera and LiDAR of one frame."""

    image_size: tuple[int, int]
    """Height, width [px]."""
    level_calibration: CalibrationMatrices
    """Calibration with a LiDAR that is level like the car, at the same place."""
    lidar: LidarConfig
    camera: CameraRig | None = None
    """Camera of the rig; None: KITTI's."""
    roof_m: float = 0.0
    """Height of the own car's roof in the LiDAR's view; 0: none."""

    @property
    def calibration(self) -> CalibrationMatrices:
        """Calibration with the LiDAR's own frame."""
        tilt = self.lidar.tilt
        if tilt is None:
            return self.level_calibration
        camera_from_lidar = self.level_calibration.camera_from_lidar @ tilt.level_from_lidar
        return replace(self.level_calibration, camera_from_lidar=camera_from_lidar)

    @property
    def lidar_pose(self) -> LidarPose | None:
        """Mount of the LiDAR over the road; None: KITTI's."""
        if self.camera is None:
            return None
        return LidarPose(height_m=self.lidar.height_m, tilt=self.lidar.tilt)


@lru_cache(maxsize=16)
def mount(rig: Rig) -> Sensors:
    """Mount a rig on the car."""
    camera = rig.camera
    x, y = camera.principal
    projection = np.array(
        [[camera.focal_px, 0.0, x, 0.0], [0.0, camera.focal_px, y, 0.0], [0.0, 0.0, 1.0, 0.0]]
    )
    return Sensors(
        image_size=camera.image_size,
        level_calibration=CalibrationMatrices(
            image_from_camera=projection,
            camera_from_lidar=_camera_from_level(camera, rig.lidar.height_m),
        ),
        lidar=lidar_config(rig.lidar),
        camera=camera,
        roof_m=rig.lidar.roof_m,
    )


def _camera_from_level(camera: CameraRig, lidar_height_m: float) -> Float64[np.ndarray, "4 4"]:
    level_from_body = Tilt(roll_deg=camera.roll_deg, pitch_deg=camera.pitch_deg).level_from_lidar
    camera_from_level = np.eye(4)
    camera_from_level[:3, :3] = LEVEL_CAMERA_AXES @ level_from_body[:3, :3].T
    place = np.array((camera.ahead_m, camera.left_m, camera.height_m - lidar_height_m))
    camera_from_level[:3, 3] = -camera_from_level[:3, :3] @ place
    return camera_from_level


def lidar_config(rig: LidarRig) -> LidarConfig:
    """Build the configuration of a rig's LiDAR."""
    lasers = tuple(Laser(elevation_deg=elevation) for elevation in rig.elevations_deg)
    azimuth_resolution_deg = 0.0
    if rig.model is not None:
        lasers = LIDARS[rig.model].lasers
        azimuth_resolution_deg = LIDARS[rig.model].azimuth_resolution_deg
    is_tilted = bool(rig.pitch_deg or rig.roll_deg)
    reach_m = _REACH_SHARE * rig.range_m
    return LidarConfig(
        lasers=lasers,
        rosette=rig.rosette,
        azimuth_step_deg=rig.azimuth_step_deg,
        azimuth_resolution_deg=azimuth_resolution_deg,
        blind_sectors=tuple(
            BlindSector(azimuth_deg=(start, end), below_deg=below)
            for start, end, below in rig.blind_sectors
        ),
        height_m=rig.height_m,
        tilt=Tilt(roll_deg=rig.roll_deg, pitch_deg=rig.pitch_deg) if is_tilted else None,
        max_range_m=rig.range_m,
        reach_m=reach_m,
        range_noise_m=rig.range_noise_m,
        # The weakest echo falls with the square of the reach.
        detectable_echo=_KITTI.detectable_echo * (_KITTI.reach_m / reach_m) ** 2,
        reading_scale=rig.reflectance,
        order=rig.order,
        min_range_m=_OWN_CAR_RANGE_M if rig.roof_m else _KITTI.min_range_m,
    )

"""Sensors on a roof other than KITTI's, and recordings that they take of simulated streets."""

import io
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float32

from sightline.data.formats.image_file import write_rgb
from sightline.data.formats.kitti_calibration import CalibrationMatrices
from sightline.data.formats.kitti_labels import write_objects
from sightline.data.formats.map_png import write_depth_png
from sightline.data.formats.recording_calibration import (
    RecordingCalibration,
    recording_calibration_text,
)
from sightline.files.atomic import atomic_write_bytes, atomic_write_text
from sightline.simulation.camera.camera import CameraConfig, render_camera
from sightline.simulation.labels import label_frame
from sightline.simulation.lidar import take_sweep
from sightline.simulation.lidar_config import LIDARS, LidarConfig
from sightline.simulation.rays.raycast import Raycaster
from sightline.simulation.settings import KITTI_IMAGE_SIZE, SimulationConfig
from sightline.simulation.simulator import calibration_of, simulate_street

_MAX_INTENSITY = 255.0  # as most drivers deliver it
_MAX_DEPTH_M = 250.0  # a 16-bit depth map ends at 256 m


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Rig:
    """A camera and a LiDAR on a car."""

    title: str
    calibration: CalibrationMatrices
    image_size: tuple[int, int]
    """Height, width [px]."""
    lidar: LidarConfig

    @property
    def focal_px(self) -> float:
        """Focal length along the camera's columns [px]."""
        return float(self.calibration.image_from_camera[1, 1])


def _own_calibration() -> CalibrationMatrices:
    """The example of docs/recordings.md: a camera 0.3 m ahead of the LiDAR and 0.4 m below it."""
    camera_matrix = [[1100.0, 0.0, 959.5], [0.0, 1100.0, 599.5], [0.0, 0.0, 1.0]]
    camera_from_lidar = [
        [0.0, -1.0, 0.0, 0.1],
        [0.0, 0.0, -1.0, -0.4],
        [1.0, 0.0, 0.0, -0.3],
        [0.0, 0.0, 0.0, 1.0],
    ]
    return CalibrationMatrices(
        image_from_camera=np.pad(np.array(camera_matrix), ((0, 0), (0, 1))),
        camera_from_lidar=np.array(camera_from_lidar),
    )


_KITTI_CALIBRATION: Final = calibration_of(SimulationConfig())
_OWN_CALIBRATION: Final = _own_calibration()
_OWN_IMAGE_SIZE: Final = (1200, 1920)
_OWN_HEIGHT_M: Final = 2.1

RIGS: Final[Mapping[str, Rig]] = {
    "kitti": Rig(
        title="KITTI's: 1242x375, 64 beams at 1.73 m",
        calibration=_KITTI_CALIBRATION,
        image_size=KITTI_IMAGE_SIZE,
        lidar=LIDARS["hdl-64e"],
    ),
    "kitti-32": Rig(
        title="KITTI's camera, 32 beams at 1.73 m",
        calibration=_KITTI_CALIBRATION,
        image_size=KITTI_IMAGE_SIZE,
        lidar=LIDARS["hdl-32e"],
    ),
    "own": Rig(
        title="own: 1920x1200, 32 beams at 2.1 m",
        calibration=_OWN_CALIBRATION,
        image_size=_OWN_IMAGE_SIZE,
        lidar=replace(LIDARS["hdl-32e"], height_m=_OWN_HEIGHT_M),
    ),
}
"""Sensors of the table; the intermediate ones separate the loss by fewer beams."""


def record_street(rig: Rig, folder: Path, *, seed: int, index: int) -> None:
    """Record one street as a frame of a recording, in the layout of docs/recordings.md.

    JPG, .npy with intensities up to 255, labels, dense depth; a frame that is there is kept. The
    calibration does not contain the LiDAR's height.
    """
    name = f"{index:06d}"
    cloud_path = folder / "points" / f"{name}.npy"
    if cloud_path.is_file():  # written last
        return
    street = simulate_street(SimulationConfig(seed=seed), index)
    scene = street.snapshot(0.0)
    raycaster = Raycaster(scene.mesh)
    camera_rng, lidar_rng = (
        np.random.default_rng(child) for child in np.random.SeedSequence([seed, index, 0]).spawn(2)
    )
    height_m = rig.lidar.height_m
    picture = render_camera(
        scene,
        rig.calibration,
        rig.image_size,
        rng=camera_rng,
        config=CameraConfig(lidar_height_m=height_m),
        raycaster=raycaster,
    )
    assert picture.image is not None, "the settings ask for a picture"
    points = take_sweep(scene, raycaster, rng=lidar_rng, config=rig.lidar)
    labels = label_frame(scene, picture.owners, rig.calibration, height_m)
    depth_m = np.where(picture.depth_m <= _MAX_DEPTH_M, picture.depth_m, np.float32(0))
    calibration = RecordingCalibration(matrices=rig.calibration, max_intensity=_MAX_INTENSITY)
    atomic_write_text(folder / "calibration.yaml", recording_calibration_text(calibration))
    write_rgb(folder / "images" / f"{name}.jpg", picture.image)
    write_objects(folder / "labels" / f"{name}.txt", labels.objects)
    write_depth_png(folder / "depth" / f"{name}.png", depth_m)
    _write_cloud(cloud_path, points)


def _write_cloud(path: Path, points: Float32[np.ndarray, "num_points 4"]) -> None:
    file = io.BytesIO()
    np.save(file, points * np.array([1, 1, 1, _MAX_INTENSITY], np.float32))
    atomic_write_bytes(path, file.getvalue())

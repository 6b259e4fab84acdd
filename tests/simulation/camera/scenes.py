"""Small scenes and a small camera like KITTI's, for the tests of this folder."""

from dataclasses import replace

import numpy as np

from sightline.data.formats.kitti_calibration import CalibrationMatrices
from sightline.data.formats.pixels import resized_and_cropped
from sightline.simulation.camera.camera import CameraConfig, SensorConfig
from sightline.simulation.scene import Actor, Light, Material, Mesh, Pose, Scene

IMAGE_SIZE = (94, 311)
QUIET = CameraConfig(
    sensor=SensorConfig(
        sensitivity=1.0,
        metering=0.0,
        vignette=0.0,
        lens_blur_px=0.0,
        resampling_blur_px=0.0,
        photon_noise=0.0,
        read_noise=0.0,
    )
)
"""A camera without faults that does not measure its exposure."""

DAY = Light(
    sun_direction=(-0.36, 0.48, 0.8),
    sun_color=(10.0, 9.4, 8.4),
    sun_softness=0.005,
    sky_zenith=(0.3, 0.5, 0.9),
    sky_horizon=(0.8, 0.9, 1.0),
    cloud_cover=0.2,
    haze_m=1000.0,
    exposure=0.3,
)
EVEN = Light(
    sun_direction=(0.0, 0.0, 1.0),
    sun_color=(0.0, 0.0, 0.0),
    sun_softness=0.0,
    sky_zenith=(1.0, 1.0, 1.0),
    sky_horizon=(1.0, 1.0, 1.0),
    cloud_cover=0.0,
    haze_m=1e9,
    exposure=0.5,
)
"""The same light from all of the sky, and no sun."""
DUSK = replace(
    DAY,
    sun_color=(0.0, 0.0, 0.0),
    sky_zenith=(0.03, 0.04, 0.08),
    sky_horizon=(0.12, 0.10, 0.09),
    exposure=4.0,
)


def small_calibration():
    """KITTI's camera 2 at a quarter of its size."""
    image_from_camera = [
        [721.5377, 0.0, 609.5593, 44.85728],
        [0.0, 721.5377, 172.854, 0.2163791],
        [0.0, 0.0, 1.0, 0.002745884],
    ]
    camera_from_lidar = [
        [0.0, -1.0, 0.0, 0.0],
        [0.0, 0.0, -1.0, -0.08],
        [1.0, 0.0, 0.0, -0.27],
        [0.0, 0.0, 0.0, 1.0],
    ]
    calibration = CalibrationMatrices(
        image_from_camera=np.array(image_from_camera),
        camera_from_lidar=np.array(camera_from_lidar),
    )
    return resized_and_cropped(calibration, 0.25, 0, 0)


def rectangle(corner, along, up, material, color=(0.4, 0.4, 0.4)):
    """A flat rectangle; u runs along its first side and v along its second [m]."""
    corner, along, up = (np.asarray(values, np.float64) for values in (corner, along, up))
    vertices = np.stack((corner, corner + along, corner + along + up, corner + up))
    normal = np.cross(along, up) / np.linalg.norm(np.cross(along, up))
    sides = np.array([np.linalg.norm(along), np.linalg.norm(up)])
    return Mesh(
        vertices=vertices.astype(np.float32),
        normals=np.tile(normal, (4, 1)).astype(np.float32),
        uvs=(sides * [[0, 0], [1, 0], [1, 1], [0, 1]]).astype(np.float32),
        faces=np.array([[0, 1, 2], [0, 2, 3]], np.int32),
        materials=np.full(2, material, np.int32),
        colors=np.tile(np.array(color, np.float32), (2, 1)),
    )


def ground(material=Material.CONCRETE, color=(0.3, 0.3, 0.3), reach=400.0):
    """Level ground at z = 0 all around."""
    size = 2 * reach
    return rectangle((-reach, -reach, 0), (size, 0, 0), (0, size, 0), material, color)


def block(low, high, material=Material.PLASTIC, color=(0.4, 0.4, 0.4)):
    """A box along the axes between two corners."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    x, y, z = (x1 - x0, 0, 0), (0, y1 - y0, 0), (0, 0, z1 - z0)
    return Mesh.joined(
        [
            rectangle((x0, y0, z1), x, y, material, color),
            rectangle((x0, y0, z0), y, x, material, color),
            rectangle((x0, y0, z0), x, z, material, color),
            rectangle((x0, y1, z0), z, x, material, color),
            rectangle((x0, y0, z0), z, y, material, color),
            rectangle((x1, y0, z0), y, z, material, color),
        ]
    )


def nothing():
    """A mesh without faces."""
    return Mesh(
        vertices=np.zeros((0, 3), np.float32),
        normals=np.zeros((0, 3), np.float32),
        uvs=np.zeros((0, 2), np.float32),
        faces=np.zeros((0, 3), np.int32),
        materials=np.zeros(0, np.int32),
        colors=np.zeros((0, 3), np.float32),
    )


class _Still:
    """Shape and motion of a standing object."""

    def at(self, time_s):  # noqa: ARG002 - a `Shape` and a `Motion`
        raise AssertionError("the scene is made already")


def scene_of(street, objects=(), light=DAY, ego=None):
    """A scene of street meshes and objects; each object is an actor."""
    parts = [*street, *objects]
    owners = [-1] * len(street) + list(range(len(objects)))
    lengths = [len(part.faces) for part in parts]
    origin = Pose(x=0.0, y=0.0, z=0.0, yaw=0.0)
    actor = Actor(class_name="Car", size_lwh=(4.0, 1.6, 1.5), shape=_Still(), motion=_Still())
    return Scene(
        mesh=Mesh.joined(parts) if parts else nothing(),
        owners=np.repeat(np.array(owners, np.int32), lengths),
        actors=(actor,) * len(objects),
        poses=(origin,) * len(objects),
        ego=ego or origin,
        light=light,
    )

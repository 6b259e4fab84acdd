"""Augmentation of whole scenes, including labels: resize, rotate, scale.

Each function returns a new sample with consistent image, sweep, depth, calibration, pose and
labels; with `augmentation.mirror` and `augmentation.crop` they are the augmentation of detectors.
"""

import math
from dataclasses import replace

import cv2
import torch
from jaxtyping import Float32, Float64
from torch import Tensor

from sightline.geometry.arguments import plain_size
from sightline.geometry.boxes3d import Boxes3D
from sightline.geometry.calibration import Calibration
from sightline.geometry.transforms import rigid_inverse, transform_points
from sightline.structures.labels import ObjectLabels
from sightline.structures.sample import CameraLidarSample


def resize(sample: CameraLidarSample, height: int, width: int) -> CameraLidarSample:
    """Resize the image, with the same view.

    Pixels are averaged or, for a larger image, interpolated (bicubic); for depths see `resize_map`.
    The sweep and 3D labels stay.

    Raises:
        ValueError: There would be no pixel.
    """
    if height < 1 or width < 1:
        raise ValueError(f"an image needs at least 1x1 pixels, got {height}x{width}; name a size")
    old_height, old_width = sample.image_size
    scale = (width / old_width, height / old_height)
    image, objects = sample.image, sample.objects
    if image is not None:
        has_fewer = height * width < old_height * old_width
        interpolation = cv2.INTER_AREA if has_fewer else cv2.INTER_CUBIC
        pixels = cv2.resize(
            image.permute(1, 2, 0).cpu().numpy(), (width, height), interpolation=interpolation
        )
        image = torch.from_numpy(pixels).permute(2, 0, 1).contiguous()
    if objects is not None:
        objects = replace(objects, boxes2d=objects.boxes2d.resize(*scale))
    return replace(
        sample,
        calibration=sample.calibration.resize(*scale),
        image_size=plain_size("the new size", (height, width)),
        image=image,
        depth=None if sample.depth is None else resize_map(sample.depth, height, width),
        objects=objects,
    )


def resize_map(
    depth_m: Float32[Tensor, "old_height old_width"], height: int, width: int
) -> Float32[Tensor, "height width"]:
    """Resize a depth map by nearest-neighbour sampling.

    The mean of a depth and a missing one, or of two surfaces, would be no valid depth.
    """
    nearest = cv2.INTER_NEAREST_EXACT  # by the pixels' centres, as in the calibration
    resized = cv2.resize(depth_m.cpu().numpy(), (width, height), interpolation=nearest)
    return torch.from_numpy(resized)


def turn_scene(sample: CameraLidarSample, yaw_deg: float) -> CameraLidarSample:
    """Rotate the scene counter-clockwise about the LiDAR's z axis.

    Sweep, 3D boxes and calibration rotate together, so that every point projects to the same pixel
    at the same depth; the image stays. KITTI's rotation_y assumes a camera that looks along x: do
    not write the labels of a rotated scene.
    """
    turn = torch.eye(4, dtype=torch.float64)
    cos, sin = math.cos(math.radians(yaw_deg)), math.sin(math.radians(yaw_deg))
    turn[:2, :2] = torch.tensor([[cos, -sin], [sin, cos]], dtype=torch.float64)
    back = rigid_inverse(turn)
    return replace(
        _with_sweep(sample, turn, 1.0),
        calibration=Calibration(
            image_from_camera=sample.calibration.image_from_camera,
            camera_from_lidar=sample.calibration.camera_from_lidar @ back,
        ),
        objects=_turned_objects(sample.objects, math.radians(yaw_deg)),
        world_from_lidar=None
        if sample.world_from_lidar is None
        else sample.world_from_lidar @ back,
        level_from_lidar=None
        if sample.level_from_lidar is None
        else sample.level_from_lidar @ back,
    )


def scale_scene(sample: CameraLidarSample, factor: float) -> CameraLidarSample:
    """Scale the world by `factor`, including the sensors' distances and the drive.

    Every point projects to the same pixel, at `factor` times the depth; the image stays.

    Raises:
        ValueError: The factor is not positive or not finite.
    """
    if not 0 < factor < math.inf:
        raise ValueError(f"a scene is scaled by a positive, finite factor, got {factor}")
    objects, depth, calibration = sample.objects, sample.depth, sample.calibration
    if objects is not None:
        factors = objects.boxes3d.tensor.new_tensor([factor] * 6 + [1.0])
        objects = replace(objects, boxes3d=Boxes3D(objects.boxes3d.tensor * factors))
    last_column = calibration.image_from_camera.new_tensor([1, 1, 1, factor])
    return replace(
        _with_sweep(sample, torch.eye(4, dtype=torch.float64), factor),
        calibration=Calibration(
            image_from_camera=calibration.image_from_camera * last_column,
            camera_from_lidar=_with_longer_translation(calibration.camera_from_lidar, factor),
        ),
        depth=None if depth is None else depth * factor,
        objects=objects,
        world_from_lidar=None
        if sample.world_from_lidar is None
        else _with_longer_translation(sample.world_from_lidar, factor),
    )


def _with_sweep(
    sample: CameraLidarSample, turn: Float64[Tensor, "4 4"], factor: float
) -> CameraLidarSample:
    if sample.points is None:
        return sample
    points = sample.points.clone()
    points[:, :3] = (transform_points(turn, points[:, :3].double()) * factor).float()
    return replace(sample, points=points)


def _turned_objects(objects: ObjectLabels | None, yaw_rad: float) -> ObjectLabels | None:
    if objects is None:
        return None
    turned = objects.boxes3d.turn(yaw_rad)
    return replace(objects, boxes3d=turned.where(objects.has_box3d, objects.boxes3d))


def _with_longer_translation(
    transform: Float64[Tensor, "4 4"], factor: float
) -> Float64[Tensor, "4 4"]:
    longer = transform.clone()
    longer[:3, 3] *= factor
    return longer

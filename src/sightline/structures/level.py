"""Conversion of samples and boxes between a tilted or rotated LiDAR's frame and the level frame.

Samples and predictions are in the LiDAR's own frame. `level_from_lidar` of the sample transforms
to the level frame, in which detectors work: x along the camera's view, z up.
"""

from dataclasses import replace

import torch
from jaxtyping import Float64
from torch import Tensor

from sightline.geometry.calibration import Calibration
from sightline.geometry.tilt import Tilt, level_ahead
from sightline.geometry.transforms import rigid_inverse, transform_points
from sightline.structures.labels import ObjectLabels
from sightline.structures.predictions import Detections3D, Perception
from sightline.structures.sample import CameraLidarSample


def horizon_row(sample: CameraLidarSample) -> float | None:
    """Row [px] of the horizon straight ahead; None: the camera does not look ahead."""
    calibration = level_calibration(sample.calibration, sample.level_from_lidar)
    ahead = calibration.camera_from_lidar[:3, 0]
    _, y, z = (calibration.image_from_camera[:, :3] @ ahead).tolist()
    return y / z if z > 0 else None


def level_sample(sample: CameraLidarSample) -> CameraLidarSample:
    """Transform a sample to its level frame; unchanged if the LiDAR's own frame is level."""
    level_from_lidar = sample.level_from_lidar
    if level_from_lidar is None:
        return sample
    lidar_from_level = rigid_inverse(level_from_lidar)
    points, objects, pose = sample.points, sample.objects, sample.world_from_lidar
    if points is not None:
        places = transform_points(level_from_lidar, points[:, :3])
        points = torch.cat((places, points[:, 3:]), dim=1)
    if objects is not None:
        levelled = objects.boxes3d.to_level(level_from_lidar)
        objects = replace(objects, boxes3d=levelled.where(objects.has_box3d, objects.boxes3d))
    return replace(
        sample,
        points=points,
        objects=objects,
        calibration=level_calibration(sample.calibration, level_from_lidar),
        world_from_lidar=None if pose is None else pose @ lidar_from_level,
        level_from_lidar=None,
    )


def level_from_mount(calibration: Calibration, tilt: Tilt | None) -> Float64[Tensor, "4 4"] | None:
    """Compute `level_ahead` of a calibration; None: the LiDAR's own frame is level enough."""
    level_from_lidar = level_ahead(calibration.camera_from_lidar.numpy(), tilt)
    return None if level_from_lidar is None else torch.from_numpy(level_from_lidar)


def level_calibration(
    calibration: Calibration, level_from_lidar: Float64[Tensor, "4 4"] | None
) -> Calibration:
    """Transform a calibration to the level frame."""
    if level_from_lidar is None:
        return calibration
    return Calibration(
        image_from_camera=calibration.image_from_camera,
        camera_from_lidar=calibration.camera_from_lidar @ rigid_inverse(level_from_lidar),
    )


def level_detections(detections: Detections3D, sample: CameraLidarSample) -> Detections3D:
    """Transform detections from the LiDAR's own frame to the level frame."""
    if sample.level_from_lidar is None:
        return detections
    return replace(detections, boxes=detections.boxes.to_level(sample.level_from_lidar))


def mounted_detections(detections: Detections3D, sample: CameraLidarSample) -> Detections3D:
    """Transform detections from the level frame to the LiDAR's own frame."""
    if sample.level_from_lidar is None:
        return detections
    return replace(detections, boxes=detections.boxes.from_level(sample.level_from_lidar))


def mounted_labels(
    objects: ObjectLabels, level_from_lidar: Float64[Tensor, "4 4"] | None
) -> ObjectLabels:
    """Transform labels from the level frame to the LiDAR's own frame."""
    if level_from_lidar is None:
        return objects
    mounted = objects.boxes3d.from_level(level_from_lidar)
    return replace(objects, boxes3d=mounted.where(objects.has_box3d, objects.boxes3d))


def level_view(
    sample: CameraLidarSample, perception: Perception
) -> tuple[CameraLidarSample, Perception]:
    """Transform a sample and its predictions to the level frame, for drawing."""
    detections, objects = perception.detections3d, perception.objects
    if detections is not None:
        perception = replace(perception, detections3d=level_detections(detections, sample))
    if objects is not None and sample.level_from_lidar is not None:
        levelled = objects.boxes3d.to_level(sample.level_from_lidar)
        boxes3d = levelled.where(objects.has_box3d, objects.boxes3d)
        perception = replace(perception, objects=replace(objects, boxes3d=boxes3d))
    return level_sample(sample), perception

"""Points whose origin is not the LiDAR's: in a vehicle's frame, on the road or at its axles."""

from dataclasses import replace
from typing import Final

import torch
from jaxtyping import Float, Float64
from torch import Tensor

from sightline.data.formats.ring_elevations import share_between_rings
from sightline.geometry.calibration import Calibration
from sightline.geometry.kitti_mount import KITTI_LIDAR_HEIGHT_M
from sightline.structures.sample import CameraLidarSample

_MIN_LIDAR_HEIGHT_M: Final = 0.3
"""Height of an origin above the road from which it is a LiDAR's; lower ones are, if their points
show rings."""
_MAX_SHARE_BETWEEN: Final = 0.08
"""Largest share of points between rings that are seen from the LiDAR. Real sweeps have up to 0.03,
simulated ones 0.07; seen from the road most have 0.09 or more, and less from higher up."""


def vehicle_frame_doubt(sample: CameraLidarSample) -> str | None:
    """Describe a cloud whose origin is on the road, where no LiDAR is; None if it is a LiDAR's.

    A low origin is a LiDAR's if the points separate into rings seen from there, and better than
    seen from KITTI's height of a LiDAR.
    """
    height_m = sample.lidar_height_m
    if height_m is None or height_m >= _MIN_LIDAR_HEIGHT_M:
        return None
    if sample.points is not None:
        from_origin = share_between_rings(sample.points.numpy())
        if from_origin <= _MAX_SHARE_BETWEEN:
            raised = _raised_points(sample, height_m)[0]
            if from_origin < share_between_rings(raised.numpy()):
                return None
    return (
        f"the points of {sample.sample_id} have their origin {height_m:.2f} m above the road, as "
        "in a vehicle's frame: the LiDAR's place is unknown"
    )


def seen_from_lidar(sample: CameraLidarSample) -> CameraLidarSample:
    """Move the origin of points in a vehicle's frame up to KITTI's height of a LiDAR.

    Elevations then are about those of the LiDAR's beams. Points and calibration change, labels and
    pose are left out. A sample whose origin is not on the road is unchanged.
    """
    if sample.points is None or vehicle_frame_doubt(sample) is None:
        return sample
    assert sample.lidar_height_m is not None, "a vehicle's frame has a height"
    points, sample_from_raised = _raised_points(sample, sample.lidar_height_m)
    return replace(
        sample,
        points=points,
        calibration=Calibration(
            image_from_camera=sample.calibration.image_from_camera,
            camera_from_lidar=sample.calibration.camera_from_lidar @ sample_from_raised,
        ),
        objects=None,
        world_from_lidar=None,
        lidar_height_m=KITTI_LIDAR_HEIGHT_M,
    )


def _raised_points(
    sample: CameraLidarSample, height_m: float
) -> tuple[Float[Tensor, "num_points fields"], Float64[Tensor, "4 4"]]:
    """Points seen from KITTI's height of a LiDAR, and the transform back from there."""
    assert sample.points is not None, "only points have an origin"
    sample_from_raised = torch.eye(4, dtype=torch.float64)
    level = sample.level_from_lidar
    up = sample_from_raised[2, :3] if level is None else level[2, :3]
    sample_from_raised[:3, 3] = (KITTI_LIDAR_HEIGHT_M - height_m) * up
    points = sample.points.clone()
    points[:, :3] -= sample_from_raised[:3, 3].float()
    return points, sample_from_raised

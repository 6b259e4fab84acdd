"""Preparation of a sweep for the networks: range, view and sampling."""

from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float, Float32, Int64
from torch import Tensor

from sightline.augmentation.sample_changes import points_in_view
from sightline.detection3d.detector_config import SweepConfig
from sightline.geometry.boxes3d import Boxes3D
from sightline.structures.level import level_sample, mounted_detections
from sightline.structures.predictions import Detections3D
from sightline.structures.sample import CameraLidarSample
from sightline.structures.sweep_checks import check_finite_points


def cut_to_view(sample: CameraLidarSample, config: SweepConfig) -> CameraLidarSample:
    """Keep the points inside the camera image, if the settings ask for it.

    Raises:
        ValueError: The sample has no sweep, or a point of it is not finite.
    """
    points = sample.points
    if points is None:
        raise ValueError(
            f"sample {sample.sample_id} has no sweep, so nothing can be detected; give data with "
            "velodyne files"
        )
    check_finite_points(sample)
    return replace(sample, points=points[points_in_view(sample)]) if config.in_view else sample


def at_kitti_height(sample: CameraLidarSample) -> CameraLidarSample:
    """Transform a sample to a LiDAR frame like KITTI's: level, x ahead, at the same height.

    `in_own_frame` is the inverse for detections.
    """
    sample = level_sample(sample)
    rise_m = sample.higher_than_kitti_m
    if sample.points is None or not rise_m:
        return sample
    old_from_new = torch.eye(4, dtype=torch.float64)
    old_from_new[2, 3] = -rise_m
    camera_from_lidar = sample.calibration.camera_from_lidar @ old_from_new
    objects = sample.objects
    if objects is not None:
        boxes = objects.boxes3d.tensor
        raised = Boxes3D(boxes + boxes.new_tensor([0, 0, rise_m, 0, 0, 0, 0]))
        objects = replace(objects, boxes3d=raised)
    return replace(
        sample,
        points=sample.points + sample.points.new_tensor([0, 0, rise_m, 0]),
        objects=objects,
        calibration=replace(sample.calibration, camera_from_lidar=camera_from_lidar),
        lidar_height_m=None,
    )


def in_own_frame(found: Detections3D, sample: CameraLidarSample) -> Detections3D:
    """Transform detections in `at_kitti_height(sample)` to the sample's own LiDAR frame."""
    down = found.boxes.tensor.new_tensor([0, 0, sample.higher_than_kitti_m, 0, 0, 0, 0])
    lowered = replace(found, boxes=Boxes3D(found.boxes.tensor - down))
    return mounted_detections(lowered, sample)


def points_in_range(
    points: Float32[Tensor, "num_points 4"], config: SweepConfig
) -> Float32[Tensor, "num_seen 4"]:
    """Keep the points in the network's range, in their order, raised by the height offset."""
    raised = points + points.new_tensor([0, 0, config.height_offset_m, 0])
    low, high = (points.new_tensor(corner) for corner in (config.lowest_m, config.highest_m))
    xyz = raised[:, :3]
    return raised[((xyz >= low) & (xyz <= high)).all(dim=1)]


def draw_points(
    points: Float32[Tensor, "num_seen 4"], config: SweepConfig, rng: np.random.Generator
) -> Float32[Tensor, "num_points 4"]:
    """Draw exactly `num_points` points in random order, or none from an empty sweep.

    If `num_points` is None, keep all in order. Shi et al. 2019 (PointRCNN), in its published code:
    from more points, all far ones stay, and near ones are drawn without repetition; if there are
    too many far ones, all points are equally likely. Of fewer points, all stay and some are
    repeated. The order is random because a ball query takes the first points that it finds.
    """
    if config.num_points is None:
        return points
    return points[torch.from_numpy(_choice(points, config, rng))]


def _choice(
    points: Float[Tensor, "num_seen 4"], config: SweepConfig, rng: np.random.Generator
) -> Int64[np.ndarray, " num_points"]:
    count, wanted = len(points), config.num_points
    assert wanted is not None, "there is something to choose"
    everything = np.arange(count)
    if count == 0:
        return everything
    if count <= wanted:
        chosen = np.concatenate((everything, rng.integers(count, size=wanted - count)))
        return rng.permutation(chosen)
    is_far = (points[:, 0] >= config.far_m).numpy()
    far, near = everything[is_far], everything[~is_far]
    if len(far) >= wanted:
        return rng.permutation(everything)[:wanted]
    return rng.permutation(np.concatenate((far, rng.permutation(near)[: wanted - len(far)])))

"""A frame and what was found in it, at the size at which both are shown."""

from dataclasses import replace

import torch

from sightline.augmentation.scene_changes import resize, resize_map
from sightline.structures.predictions import DepthMap, Perception
from sightline.structures.sample import CameraLidarSample


def zoomed(
    sample: CameraLidarSample, told: Perception, size: tuple[int, int]
) -> tuple[CameraLidarSample, Perception]:
    """Both at an image size of (height, width); 3D boxes stay, the calibration follows."""
    height, width = sample.image_size
    depth, found = told.depth, told.detections2d
    if depth is not None:
        depth = _zoomed_depth(depth, size)
    if found is not None:
        found = replace(found, boxes=found.boxes.resize(size[1] / width, size[0] / height))
    return resize(sample, *size), replace(told, depth=depth, detections2d=found)


def _zoomed_depth(depth: DepthMap, size: tuple[int, int]) -> DepthMap:
    error_m = depth.uncertainty_m
    return DepthMap(
        depth_m=resize_map(depth.depth_m, *size),
        valid=resize_map(depth.valid.to(torch.float32), *size) > 0,
        uncertainty_m=None if error_m is None else resize_map(error_m, *size),
    )

"""Scaling of a frame and its predictions for drawing."""

from dataclasses import replace

import torch

from sightline.augmentation.scene_changes import resize, resize_map
from sightline.structures.predictions import DepthMap, Perception
from sightline.structures.sample import CameraLidarSample


def zoomed(
    sample: CameraLidarSample, perception: Perception, size: tuple[int, int]
) -> tuple[CameraLidarSample, Perception]:
    """Scale both to an image size of (height, width) with the calibration; 3D boxes stay."""
    height, width = sample.image_size
    depth, detections, objects = perception.depth, perception.detections2d, perception.objects
    factors = (size[1] / width, size[0] / height)
    if depth is not None:
        depth = _zoomed_depth(depth, size)
    if detections is not None:
        detections = replace(detections, boxes=detections.boxes.resize(*factors))
    if objects is not None:
        objects = replace(objects, boxes2d=objects.boxes2d.resize(*factors))
    return resize(sample, *size), replace(
        perception, objects=objects, depth=depth, detections2d=detections
    )


def _zoomed_depth(depth: DepthMap, size: tuple[int, int]) -> DepthMap:
    error_m, guessed = depth.uncertainty_m, depth.guessed
    return DepthMap(
        depth_m=resize_map(depth.depth_m, *size),
        valid=resize_map(depth.valid.to(torch.float32), *size) > 0,
        uncertainty_m=None if error_m is None else resize_map(error_m, *size),
        guessed=(None if guessed is None else resize_map(guessed.to(torch.float32), *size) > 0),
    )

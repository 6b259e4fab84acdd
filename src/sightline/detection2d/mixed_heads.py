"""Mixture of the sensors' own heads by the gates."""

from collections.abc import Sequence

import torch
from torch import Tensor

from sightline.detection2d.readings import GateReading, HeadReading

_LEAST_GATE = 1e-3  # so that two closed gates have equal weights, free of rounding errors


def mix_heads(
    joint: HeadReading, camera: HeadReading, lidar: HeadReading, gates: Sequence[GateReading]
) -> HeadReading:
    """Average the sensors' own heads, weighted by their gates, and add the joint head.

    If one gate is closed, the other sensor's head has the full weight: a detector that has lost a
    sensor behaves like one that never had it. The joint head adds the information of both sensors
    together.

    Args:
        joint: Output of the head on the fused maps, before the sigmoid.
        camera: Output of the camera stream's own head for the same places.
        lidar: Output of the LiDAR stream's own head.
        gates: Gates of each map, the finest first; none: both sensors have equal weights.
    """
    if gates:
        weights = [
            torch.cat([_per_place(logits) for logits in each], dim=1).clamp(min=_LEAST_GATE)
            for each in zip(*gates, strict=True)
        ]
        camera_share = weights[0] / (weights[0] + weights[1])
    else:
        camera_share = camera.class_logits.new_full(camera.class_logits.shape[:2], 0.5)
    share = camera_share[:, :, None]
    classes, boxes = (
        own + share * of_camera + (1 - share) * of_lidar
        for own, of_camera, of_lidar in zip(joint[:2], camera[:2], lidar[:2], strict=True)
    )
    return HeadReading(class_logits=classes, box_logits=boxes, places=joint.places)


def _per_place(logits: Tensor) -> Tensor:
    """Compute the mean gate of each of a map's places, row by row."""
    return logits.float().sigmoid().mean(dim=1).flatten(1)

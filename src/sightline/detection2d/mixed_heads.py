"""Answers of the sensors' own heads, mixed as the gates say."""

from collections.abc import Sequence

import torch
from torch import Tensor

from sightline.detection2d.readings import GateReading, HeadReading

_LEAST_GATE = 1e-3  # so that two closed gates count alike, and not as their last digits say


def mix_heads(
    joint: HeadReading, camera: HeadReading, lidar: HeadReading, gates: Sequence[GateReading]
) -> HeadReading:
    """The mean of what the sensors' own heads say, weighted by their gates, plus the joint head's.

    Where one gate is closed, its sensor says nothing, and the other's head is heard in full: a
    detector that has lost a sensor answers as one that never had it. The joint head says what both
    sensors together know beyond that.

    Args:
        joint: What the head on the fused maps says, before the sigmoid.
        camera: What the camera stream's own head says of the same places.
        lidar: What the LiDAR stream's own head says.
        gates: Of each map, the finest first; none: both sensors count alike.
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
    """The mean gate of each of a map's places, row by row."""
    return logits.float().sigmoid().mean(dim=1).flatten(1)

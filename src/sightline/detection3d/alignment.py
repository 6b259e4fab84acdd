"""Output transformation (Wang et al. 2020): adapt boxes to the labels of other sensors."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch

from sightline.geometry.boxes3d import Boxes3D
from sightline.structures.predictions import Detections3D

_LONGEST_M, _SHORTEST_BOX_M = 10.0, 0.1


@dataclass(frozen=True, kw_only=True)
class ClassAlignment:
    """Correction of one class's boxes towards the target labels."""

    name: str
    """Name of the class, such as Car."""
    length_m: float = 0.0
    """Length added to each box."""
    towards_m: float = 0.0
    """Distance that the centre moves towards the LiDAR along the box's own axis, times the absolute
    cosine of the angle between that axis and the direction to the LiDAR."""

    def __post_init__(self) -> None:
        """Checks the numbers."""
        for name, value in (("length_m", self.length_m), ("towards_m", self.towards_m)):
            if not (math.isfinite(value) and abs(value) <= _LONGEST_M):
                raise ValueError(
                    f"alignment.{name} must be from -{_LONGEST_M:g} to {_LONGEST_M:g}, got {value}"
                )


def align(found: Detections3D, alignments: Sequence[ClassAlignment]) -> Detections3D:
    """Move and resize detections (LiDAR frame), with one correction for each class.

    Wang et al. 2020 (Train in Germany, Test in the USA) add the mean size difference of two data
    sets to a detector's boxes. Here boxes are also moved along their axes.
    """
    boxes = found.boxes.tensor.clone()
    for alignment in alignments:
        chosen = torch.tensor(
            [name == alignment.name for name in found.class_names], dtype=torch.bool
        )
        each = boxes[chosen]
        each[:, 3] = (each[:, 3] + alignment.length_m).clamp(min=_SHORTEST_BOX_M)
        ahead = torch.stack((each[:, 6].cos(), each[:, 6].sin()), dim=1)
        away = torch.nn.functional.normalize(each[:, :2], dim=1)
        along = (ahead * away).sum(dim=1, keepdim=True)
        each[:, :2] -= alignment.towards_m * along * ahead
        boxes[chosen] = each
    return Detections3D(class_names=found.class_names, boxes=Boxes3D(boxes), scores=found.scores)

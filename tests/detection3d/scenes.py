"""Simple sweeps with road users that the tests of the compact design share."""

import math

import torch

from sightline.detection3d.sweeps import SweepTruth
from sightline.geometry.boxes3d import Boxes3D


def box_surface(box: list[float], count: int, generator: torch.Generator) -> torch.Tensor:
    """Points on the front of a box and on the two sides beside it."""
    length, width, height = box[3:6]
    along = torch.rand(count, generator=generator) - 0.5
    up = torch.rand(count, generator=generator) - 0.5
    side = torch.arange(count) % 4
    x = torch.where(side < 2, 0.5, along)
    y = torch.where(side < 2, along, side - 2.5)
    place = torch.stack((x * length, y * width, up * height), dim=1)
    cos, sin = math.cos(box[6]), math.sin(box[6])
    turned = torch.stack(
        (cos * place[:, 0] - sin * place[:, 1], sin * place[:, 0] + cos * place[:, 1], place[:, 2]),
        dim=1,
    )
    return turned + torch.tensor(box[:3])


def sweep_of(boxes: list[list[float]], seed: int = 0) -> torch.Tensor:
    """x, y, z, reflectance of the boxes' sides and of the ground around them."""
    generator = torch.Generator().manual_seed(seed)
    ground = torch.rand(1500, 3, generator=generator) * torch.tensor([18.0, 18.0, 0.04])
    ground += torch.tensor([1.0, -9.0, -1.75])
    is_free = ~Boxes3D(torch.tensor(boxes)).contain(ground).any(dim=0)
    parts = [ground[is_free], *(box_surface(box, 120, generator) for box in boxes)]
    points = torch.cat(parts)
    return torch.cat((points, torch.full((len(points), 1), 0.3)), dim=1)


def scene_of(
    boxes: list[list[float]], classes: list[int], num_classes: int = 3, ignored: int = 0
) -> SweepTruth:
    """The boxes' truth, of which the last ones may be ignored for all classes."""
    rows = torch.tensor(boxes, dtype=torch.float64).reshape(-1, 7)
    found = len(rows) - ignored
    return SweepTruth(
        boxes=rows[:found],
        classes=torch.tensor(classes[:found], dtype=torch.int64),
        ignored_boxes=rows[found:],
        ignored_classes=torch.ones(ignored, num_classes, dtype=torch.bool),
    )

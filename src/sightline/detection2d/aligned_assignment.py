"""Task-aligned assignment of cells to objects (Feng et al. 2021, TOOD)."""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from sightline.detection2d.config import check_range
from sightline.detection2d.targets import DetectionTargets
from sightline.geometry.boxes2d import Boxes2D, pairwise_iou2d

_NOTHING = -1
_LEAST_IOU = 0.05  # added to the IoU, to assign also objects without overlapping boxes
_LEAST_QUALITY = 0.1  # for an object's best cell, so that it is trained from the first step


@dataclass(frozen=True, kw_only=True)
class AssignmentConfig:
    """Alignment of a cell with an object: score to the power alpha times IoU to the power beta."""

    alpha: float = 1.0
    """Exponent of the score."""
    beta: float = 6.0
    """Exponent of the IoU."""
    cells: int = 10
    """Number of best-aligned cells assigned to an object."""

    def __post_init__(self) -> None:
        """Checks the ranges."""
        check_range("assignment.alpha", self.alpha, 0, 100)
        check_range("assignment.beta", self.beta, 0, 100)
        check_range("assignment.cells", self.cells, 1, 10_000)


class Assignment(NamedTuple):
    """Target of each place."""

    objects: Int64[Tensor, " places"]
    """Index of the assigned object; -1 for none."""
    qualities: Float[Tensor, " places"]
    """Target score of the object's class; 0 for none."""


def assign_places(
    scores: Float[Tensor, "places classes"],
    boxes: Float[Tensor, "places 4"],
    places: Float[Tensor, "places 4"],
    truth: DetectionTargets,
    config: AssignmentConfig,
) -> Assignment:
    """Assign each object the best-aligned places among those in its box: section 3.2.

    An object that contains no place's centre gets the place nearest to its own centre. If several
    objects want a place, it goes to the object that its box overlaps most. Qualities are the
    alignments, scaled so that an object's best place has the highest IoU of its places: eq. 8.
    Departures: 0.05 is added to the IoU, and a best place's quality is at least 0.1.

    Args:
        scores: Predicted scores, in [0, 1].
        boxes: Predicted boxes, corners [px].
        places: Middles and sizes of cells [px].
        truth: Ground truth of one image.
        config: Definition of the alignment.
    """
    count = len(places)
    if not len(truth.boxes):
        return Assignment(
            torch.full((count,), _NOTHING, device=places.device), places.new_zeros(count)
        )
    iou = pairwise_iou2d(Boxes2D(truth.boxes), Boxes2D(boxes))
    aligned = scores[:, truth.class_indices].T.clamp(min=1e-6) ** config.alpha
    aligned = aligned * (iou + _LEAST_IOU) ** config.beta
    aligned = torch.where(_is_candidate(places[:, :2], truth.boxes), aligned, 0.0)
    best = aligned.topk(min(config.cells, count), dim=1)
    wanted = torch.zeros_like(aligned).scatter(1, best.indices, best.values)
    owner_iou, objects = torch.where(wanted > 0, iou, -1.0).max(dim=0)
    objects = torch.where(owner_iou >= 0, objects, _NOTHING)
    is_own = objects == torch.arange(len(truth.boxes), device=places.device)[:, None]
    own = torch.where(is_own, aligned, 0.0)
    highest_iou = torch.where(is_own, iou, 0.0).amax(dim=1, keepdim=True)
    qualities = own / own.amax(dim=1, keepdim=True).clamp(min=1e-30)
    qualities = qualities * highest_iou.clamp(min=_LEAST_QUALITY)
    return Assignment(objects, qualities.amax(dim=0))


def _is_candidate(
    middles: Float[Tensor, "places 2"], boxes: Float[Tensor, "num_objects 4"]
) -> Bool[Tensor, "num_objects places"]:
    after = middles >= boxes[:, None, :2]
    before = middles <= boxes[:, None, 2:]
    is_inside = (after & before).all(dim=2)
    away = (middles - (boxes[:, None, :2] + boxes[:, None, 2:]) / 2).square().sum(dim=2)
    nearest = torch.zeros_like(is_inside).scatter(1, away.argmin(dim=1, keepdim=True), value=True)
    return torch.where(is_inside.any(dim=1, keepdim=True), is_inside, nearest)

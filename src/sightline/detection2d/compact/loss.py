"""Task-aligned assignment and losses of the compact detector: scores that predict the IoU."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from sightline.detection2d.compact.network import decode_distances
from sightline.detection2d.config import CLASSES
from sightline.detection2d.fusion import HeadOutput
from sightline.detection2d.targets import DetectionTargets, covered_shares
from sightline.geometry.boxes2d import Boxes2D, pairwise_iou2d
from sightline.geometry.choices import check_choices
from sightline.geometry.ranges import check_range

_NOTHING = -1
_ADDED_IOU = 0.05  # added to the IoU, to assign also objects without overlapping boxes
_MIN_BEST_QUALITY = 0.1  # for an object's best cell, so that it is trained from the first step


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
        """Check the ranges."""
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
    objects select a place, it goes to the object that its box overlaps most. Qualities are the
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
    aligned = aligned * (iou + _ADDED_IOU) ** config.beta
    aligned = torch.where(_is_candidate(places[:, :2], truth.boxes), aligned, 0.0)
    best = aligned.topk(min(config.cells, count), dim=1)
    selected = torch.zeros_like(aligned).scatter(1, best.indices, best.values)
    owner_iou, objects = torch.where(selected > 0, iou, -1.0).max(dim=0)
    objects = torch.where(owner_iou >= 0, objects, _NOTHING)
    is_own = objects == torch.arange(len(truth.boxes), device=places.device)[:, None]
    own = torch.where(is_own, aligned, 0.0)
    highest_iou = torch.where(is_own, iou, 0.0).amax(dim=1, keepdim=True)
    qualities = own / own.amax(dim=1, keepdim=True).clamp(min=1e-30)
    qualities = qualities * highest_iou.clamp(min=_MIN_BEST_QUALITY)
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


Classification = Literal["quality_focal", "varifocal"]
"""Loss for scores that predict the IoU."""

_FOCUS = 2.0  # exponents of both focal losses, as published
_VARIFOCAL_NEGATIVES = 0.75


@dataclass(frozen=True, kw_only=True)
class AlignedLossConfig:
    """Assignment of cells, and weights of the losses."""

    assignment: AssignmentConfig = AssignmentConfig()
    """Assignment of cells to objects."""
    classification: Classification = "quality_focal"
    """quality_focal: Li et al. 2020, eq. 2; varifocal: Zhang et al. 2021, eq. 2."""
    ignored_share: float = 0.5
    """Share of a box's area in an ignored region from which its cell has no loss there."""
    class_weight: float = 1.0
    """Weight of the score loss."""
    box_weight: float = 2.5
    """Weight of 1 - generalized IoU (Rezatofighi et al. 2019)."""
    distribution_weight: float = 0.5
    """Weight of the cross entropy of the distance distributions (Li et al. 2020, eq. 6)."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        check_choices(self, "aligned.")
        check_range("aligned.ignored_share", self.ignored_share, 0, 1)
        for name in ("class_weight", "box_weight", "distribution_weight"):
            check_range(f"aligned.{name}", getattr(self, name), 0, 1e6)


class AlignedLosses(NamedTuple):
    """Weighted terms of the loss."""

    classification: Float[Tensor, ""]
    boxes: Float[Tensor, ""]
    distribution: Float[Tensor, ""]


def assign_batch(
    output: HeadOutput, targets: Sequence[DetectionTargets], config: AssignmentConfig
) -> list[Assignment]:
    """Assign targets to each place of each image, given the network's current output."""
    with torch.no_grad():
        scores, boxes = output.class_logits.sigmoid(), decode_distances(output)
        return [
            assign_places(scores[index], boxes[index], output.places, truth, config)
            for index, truth in enumerate(targets)
        ]


def aligned_loss(
    output: HeadOutput,
    targets: Sequence[DetectionTargets],
    assignments: Sequence[Assignment],
    config: AlignedLossConfig,
    *,
    image_weights: Float[Tensor, " batch"] | None = None,
) -> AlignedLosses:
    """Compute the losses of a head, divided by the sum of the target qualities.

    Args:
        output: Output of the head.
        targets: Ground truth of each image.
        assignments: Assignment of each image, by this head or another one with the same places.
        config: Weights.
        image_weights: Factor on the losses of each image; None: 1.
    """
    found = decode_distances(output)
    weights = output.class_logits.new_ones(len(targets)) if image_weights is None else image_weights
    target_qualities = torch.zeros_like(output.class_logits)
    counts = torch.ones_like(output.class_logits)
    box_loss = distribution_loss = output.box_logits.sum() * 0  # for a gradient without objects
    for index, (truth, assignment) in enumerate(zip(targets, assignments, strict=True)):
        places = (assignment.objects >= 0).nonzero()[:, 0]
        objects = assignment.objects[places]
        quality = assignment.qualities[places] * weights[index]
        target_qualities[index, places, truth.class_indices[objects]] = assignment.qualities[places]
        is_ignored = ignored_places(output.places, found[index].detach(), truth, config)
        counts[index] = weights[index] * (~is_ignored | (target_qualities[index] > 0))
        boxes = truth.boxes[objects]
        box_loss = box_loss + (quality * (1 - generalized_iou(found[index, places], boxes))).sum()
        costs = distribution_costs(output.box_logits[index, places], output.places[places], boxes)
        distribution_loss = distribution_loss + (quality * costs).sum()
    number = (target_qualities.sum(dim=(1, 2)) * weights).sum().clamp(min=1)
    costs = class_costs(output.class_logits, target_qualities, config.classification)
    return AlignedLosses(
        classification=config.class_weight * (costs * counts).sum() / number,
        boxes=config.box_weight * box_loss / number,
        distribution=config.distribution_weight * distribution_loss / number,
    )


def class_costs(
    logits: Float[Tensor, "*shape"],
    target_qualities: Float[Tensor, "*shape"],
    kind: Classification,
) -> Float[Tensor, "*shape"]:
    """Loss of each score against its target quality, 0 for background."""
    entropy = F.binary_cross_entropy_with_logits(logits, target_qualities, reduction="none")
    scores = logits.sigmoid()
    if kind == "quality_focal":
        return entropy * (scores - target_qualities).abs() ** _FOCUS
    is_object = target_qualities > 0
    return entropy * torch.where(
        is_object, target_qualities, _VARIFOCAL_NEGATIVES * scores.detach() ** _FOCUS
    )


def ignored_places(
    places: Float[Tensor, "places 4"],
    boxes: Float[Tensor, "places 4"],
    truth: DetectionTargets,
    config: AlignedLossConfig,
) -> Bool[Tensor, "places classes"]:
    """Mask of places inside an ignored region, or with a box mostly inside one, by class."""
    if not len(truth.ignored_boxes):
        return torch.zeros(len(places), len(CLASSES), dtype=torch.bool, device=places.device)
    after = places[:, None, :2] >= truth.ignored_boxes[:, :2]
    before = places[:, None, :2] <= truth.ignored_boxes[:, 2:]
    is_within = (after & before).all(dim=2)
    is_within |= covered_shares(boxes, truth.ignored_boxes) >= config.ignored_share
    return (is_within[:, :, None] & truth.ignored_classes).any(dim=1)


def generalized_iou(a: Float[Tensor, "num 4"], b: Float[Tensor, "num 4"]) -> Float[Tensor, " num"]:
    """Generalized IoU of paired boxes, from -1 to 1: Rezatofighi et al. 2019, algorithm 1."""
    shared = torch.minimum(a[:, 2:], b[:, 2:]) - torch.maximum(a[:, :2], b[:, :2])
    around = torch.maximum(a[:, 2:], b[:, 2:]) - torch.minimum(a[:, :2], b[:, :2])
    intersection = shared.clamp(min=0).prod(dim=1)
    areas = [(each[:, 2:] - each[:, :2]).clamp(min=0).prod(dim=1) for each in (a, b)]
    union = areas[0] + areas[1] - intersection
    hull = around.prod(dim=1).clamp(min=1e-6)
    return intersection / union.clamp(min=1e-6) - (hull - union) / hull


def distribution_costs(
    logits: Float[Tensor, "num values"],
    places: Float[Tensor, "num 4"],
    boxes: Float[Tensor, "num 4"],
) -> Float[Tensor, " num"]:
    """Cross entropy of the two steps around each true distance, the mean of the four sides.

    Li et al. 2020, eq. 6. The target of a side beyond the last step, or on the wrong side of the
    place's middle, is the end of the scale.
    """
    steps = logits.shape[1] // 4
    middles = places[:, :2]
    distances = torch.cat((middles - boxes[:, :2], boxes[:, 2:] - middles), dim=1)
    distances = (distances / places[:, 2:].repeat(1, 2)).clamp(0, steps - 1 - 1e-3)
    lower = distances.floor()
    share = distances - lower
    chances = logits.reshape(-1, 4, steps).log_softmax(dim=2)
    index = lower.long()[..., None]
    below, above = chances.gather(2, index)[..., 0], chances.gather(2, index + 1)[..., 0]
    return -((1 - share) * below + share * above).mean(dim=1)

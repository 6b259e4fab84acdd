"""SSD's matching of priors and its multi-task loss: Liu et al. 2016, section 2.2."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from sightline.detection2d.dgfn.network import corners_of, encode_boxes
from sightline.detection2d.fusion import HeadOutput
from sightline.detection2d.targets import DetectionTargets, covered_shares
from sightline.geometry.boxes2d import Boxes2D, pairwise_iou2d
from sightline.geometry.ranges import check_range

_NOTHING = -1


@dataclass(frozen=True, kw_only=True)
class SsdLossConfig:
    """Matching of priors, and weights of the losses."""

    match_iou: float = 0.5
    """IoU with an object from which a prior is matched to it."""
    negatives_per_positive: float = 3.0
    """Number of negatives per matched prior: those with the highest loss."""
    ignored_share: float = 0.5
    """Share of a prior's area in an ignored region from which it is no negative."""
    box_weight: float = 1.0
    """Weight of the box loss relative to the class loss."""

    def __post_init__(self) -> None:
        """Check the ranges."""
        check_range("ssd.match_iou", self.match_iou, 0, 1)
        check_range("ssd.ignored_share", self.ignored_share, 0, 1)
        check_range("ssd.negatives_per_positive", self.negatives_per_positive, 0, 1e6)
        check_range("ssd.box_weight", self.box_weight, 0, 1e6)


class SsdLosses(NamedTuple):
    """Weighted terms of the loss."""

    classification: Float[Tensor, ""]
    boxes: Float[Tensor, ""]


def match_priors(
    places: Float[Tensor, "places 4"], boxes: Float[Tensor, "num_objects 4"], match_iou: float
) -> Int64[Tensor, " places"]:
    """Match priors to objects; -1 for none.

    A prior is matched to the object that it overlaps most, if the IoU is at least `match_iou`. The
    prior that an object overlaps most is matched to it in any case; if several objects share it, to
    the last.
    """
    if not len(boxes):
        return torch.full((len(places),), _NOTHING, device=places.device)
    iou = pairwise_iou2d(Boxes2D(boxes), Boxes2D(corners_of(places)))
    best_iou, matches = iou.max(dim=0)
    matches[best_iou < match_iou] = _NOTHING
    for index, prior in enumerate(iou.argmax(dim=1).tolist()):
        matches[prior] = index
    return matches


def multibox_loss(
    output: HeadOutput, targets: Sequence[DetectionTargets], config: SsdLossConfig
) -> SsdLosses:
    """Cross entropy of the classes, and smooth L1 of the offsets of matched priors.

    Both are summed over the batch and divided by the number of matched priors in it. In each image,
    negatives are the priors with the highest loss, a fixed number for each positive. An image
    without objects has no loss.
    """
    matches = torch.stack(
        [match_priors(output.places, truth.boxes, config.match_iou) for truth in targets]
    )
    is_matched = matches != _NOTHING
    classes = torch.zeros_like(matches)  # background
    box_loss = output.box_logits.sum() * 0  # a gradient of zero where there is nothing to find
    for index, truth in enumerate(targets):
        found = matches[index][is_matched[index]]
        classes[index, is_matched[index]] = truth.class_indices[found] + 1
        target = encode_boxes(truth.boxes[found], output.places[is_matched[index]])
        predicted = output.box_logits[index][is_matched[index]]
        box_loss = box_loss + F.smooth_l1_loss(predicted, target, reduction="sum")
    costs = F.cross_entropy(output.class_logits.transpose(1, 2), classes, reduction="none")
    is_ignored = torch.stack(
        [_is_ignored(output.places, truth, config.ignored_share) for truth in targets]
    )
    counts = is_matched | hardest_negatives(
        costs.detach(), is_matched, is_ignored, config.negatives_per_positive
    )
    number = is_matched.sum().clamp(min=1)
    return SsdLosses(
        classification=(costs * counts).sum() / number,
        boxes=config.box_weight * box_loss / number,
    )


def hardest_negatives(
    costs: Float[Tensor, "batch places"],
    is_matched: Bool[Tensor, "batch places"],
    is_ignored: Bool[Tensor, "batch places"],
    per_positive: float,
) -> Bool[Tensor, "batch places"]:
    """Select each image's hardest places among those neither matched nor ignored."""
    candidates = torch.where(is_matched | is_ignored, -torch.inf, costs)
    ranks = candidates.argsort(dim=1, descending=True).argsort(dim=1)
    number = (per_positive * is_matched.sum(dim=1, keepdim=True)).floor()
    return (ranks < number) & candidates.isfinite()


def _is_ignored(
    places: Float[Tensor, "places 4"], truth: DetectionTargets, share: float
) -> Bool[Tensor, " places"]:
    """Mask of priors in ignored regions of any class, since one softmax predicts all classes."""
    if not len(truth.ignored_boxes):
        return torch.zeros(len(places), dtype=torch.bool, device=places.device)
    return (covered_shares(corners_of(places), truth.ignored_boxes) >= share).any(dim=1)

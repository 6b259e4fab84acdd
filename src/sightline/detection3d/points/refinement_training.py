"""Training of the second stage: assignment and sampling of proposals, and losses."""

from typing import NamedTuple

import torch
from jaxtyping import Float, Float64, Int64
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits, smooth_l1_loss

from sightline.detection3d.points.config import ProposalSamplingConfig, RefinementLossConfig
from sightline.ops.rotated_iou import pairwise_iou_3d

_MIN_IOU = 1e-9  # boxes up to 1.3 m apart have 1e-17 by rounding

NO_TRUTH = -1
"""Object index of proposals in a frame without objects."""


class TruthAssignment(NamedTuple):
    """Assigned object of each proposal."""

    truth: Int64[Tensor, " num_proposals"]
    """Index of the object; NO_TRUTH in a frame without objects."""
    boxes: Float[Tensor, "num_proposals 7"]
    """Box of the object; zeros in a frame without objects."""
    iou: Float64[Tensor, " num_proposals"]
    """3D IoU of proposal and object."""


def assign_truths(
    iou: Float64[Tensor, "num_proposals num_truths"], truths: Float[Tensor, "num_truths 7"]
) -> TruthAssignment:
    """Assign each proposal the object of highest 3D IoU, the first of several, whatever the IoU."""
    num_proposals, num_truths = iou.shape
    if num_truths == 0:
        truth = torch.full((num_proposals,), NO_TRUTH, device=iou.device)
        boxes = truths.new_zeros(num_proposals, 7)
        return TruthAssignment(truth, boxes, iou.new_zeros(num_proposals))
    truth = first_largest(iou)
    return TruthAssignment(truth, truths[truth], iou.gather(1, truth[:, None])[:, 0])


def first_largest(values: Float64[Tensor, "rows columns"]) -> Int64[Tensor, " rows"]:
    """Index of each row's largest value, the first of several: argmax does not define which."""
    place = torch.arange(values.shape[1], device=values.device)
    is_largest = values == values.amax(dim=1, keepdim=True)
    return torch.where(is_largest, place, values.shape[1]).amin(dim=1)


class ProposalSamples(NamedTuple):
    """Sampled proposals with their objects: foreground first, then easy, then hard background."""

    proposal: Int64[Tensor, " num_samples"]
    """Indices into all proposals; some may occur several times."""
    boxes: Float[Tensor, "num_samples 7"]
    """Boxes of the assigned objects; zeros in a frame without objects."""
    iou: Float64[Tensor, " num_samples"]
    """3D IoU of proposal and object."""


def sample_proposals(
    proposals: Float[Tensor, "num_proposals 7"],
    truths: Float[Tensor, "num_truths 7"],
    config: ProposalSamplingConfig,
    *,
    generator: torch.Generator,
) -> ProposalSamples:
    """Draw exactly `num_samples` proposals of a frame; none if there are no proposals.

    Each proposal is assigned the object of highest IoU (`assign_truths`) and is foreground or
    background by that IoU. In addition, the best proposal of each object (IoU above 0 by more than
    rounding, the first of several) is foreground with that object: this adds a sample unless the
    pair is foreground already, and the pair is not background as well.

    - If all are foreground, or all background, they fill all samples.
    - Otherwise up to `max_foreground` are foreground and the rest is background.
    - Background is half easy and half hard if both exist; an odd one is easy.

    If a share is smaller than its pool, it is drawn without repetition; otherwise the whole pool is
    taken and the rest is drawn with repetition. Background has its own share for the sake of the
    confidence: most proposals of a street lie on nothing.

    Boxes are x, y, z, length, width, height, yaw (LiDAR frame, metres, radians). The generator is
    on the CPU.
    """
    iou = pairwise_iou_3d(proposals.double(), truths)
    own = assign_truths(iou, truths)
    best = _best_proposals(iou)
    is_own = own.truth[best[:, 0]] == best[:, 1]
    is_known = is_own & (own.iou[best[:, 0]] >= config.foreground_iou)
    proposal, truth = best[~is_known].unbind(dim=1)
    place = torch.arange(len(proposals) + len(proposal), device=iou.device)
    is_extra = place >= len(proposals)
    is_repeated = torch.zeros_like(is_extra)
    is_repeated[proposal[is_own[~is_known]]] = True
    source = torch.cat((place[: len(proposals)], proposal))
    boxes = torch.cat((own.boxes, truths[truth]))
    every_iou = torch.cat((own.iou, iou[proposal, truth]))
    is_background = (every_iou < config.background_iou) & ~is_extra & ~is_repeated
    is_easy = is_background & (every_iou < config.easy_iou)
    pools = [
        mask.nonzero()[:, 0]
        for mask in (
            is_extra | (every_iou >= config.foreground_iou),
            is_easy,
            is_background & ~is_easy,
        )
    ]
    foreground, easy, hard = map(len, pools)
    shares = _shares(foreground, easy, hard, config)
    drawn = [
        _draw(pool, share, generator) for pool, share in zip(pools, shares, strict=True) if share
    ]
    chosen = torch.cat([*drawn, place[:0]])
    return ProposalSamples(source[chosen], boxes[chosen], every_iou[chosen])


def _best_proposals(
    iou: Float64[Tensor, "num_proposals num_truths"],
) -> Int64[Tensor, "num_found 2"]:
    """Indices of the best proposal and the object, for each overlapped object."""
    if iou.shape[0] == 0:
        return torch.zeros((0, 2), dtype=torch.int64, device=iou.device)
    truth = (iou.amax(dim=0) > _MIN_IOU).nonzero()[:, 0]
    return torch.stack((first_largest(iou.T[truth]), truth), dim=1)


def _shares(
    foreground: int, easy: int, hard: int, config: ProposalSamplingConfig
) -> tuple[int, int, int]:
    """Compute the number of samples from each pool, given the pools' sizes."""
    if foreground + easy + hard == 0:
        return 0, 0, 0
    if easy + hard == 0:
        return config.num_samples, 0, 0
    num_foreground = min(foreground, config.max_foreground)
    num_background = config.num_samples - num_foreground
    if easy == 0:
        return num_foreground, 0, num_background
    num_hard = num_background // 2 if hard else 0
    return num_foreground, num_background - num_hard, num_hard


def _draw(
    pool: Int64[Tensor, " pool"], count: int, generator: torch.Generator
) -> Int64[Tensor, " {count}"]:
    """Draw `count` entries of a pool that is not empty."""
    if len(pool) >= count:
        chosen = torch.randperm(len(pool), generator=generator)[:count]
        return pool[chosen.to(pool.device)]
    repeated = torch.randint(len(pool), (count - len(pool),), generator=generator)
    return torch.cat((pool, pool[repeated.to(pool.device)]))


class BoxLosses(NamedTuple):
    """Scalar losses; the parts are unweighted."""

    total: Float[Tensor, ""]
    """location + size_weight * size + rotation."""
    location: Float[Tensor, ""]
    size: Float[Tensor, ""]
    rotation: Float[Tensor, ""]


def box_loss(
    predicted: Float[Tensor, "num_samples 7"],
    target: Float[Tensor, "num_samples 7"],
    iou: Float[Tensor, " num_samples"],
    config: RefinementLossConfig,
) -> BoxLosses:
    """Smooth L1 (Girshick 2015, beta 1) of foreground boxes: the mean of each part.

    Boxes are x, y, z, length, width, height, yaw. Yaws are compared as numbers: two that differ by
    a full turn count as different. Without foreground, all losses and gradients are 0.
    """
    is_foreground = iou >= config.foreground_iou
    predictions, targets = predicted[is_foreground], target[is_foreground].to(predicted.dtype)
    error = smooth_l1_loss(predictions, targets, reduction="none")
    count = is_foreground.sum().clamp(min=1)
    location, size = error[:, :3].sum() / (3 * count), error[:, 3:6].sum() / (3 * count)
    rotation = error[:, 6].sum() / count
    return BoxLosses(location + config.size_weight * size + rotation, location, size, rotation)


def confidence_loss(
    logits: Float[Tensor, " num_samples"],
    iou: Float[Tensor, " num_samples"],
    config: RefinementLossConfig,
) -> Float[Tensor, ""]:
    """Mean binary cross entropy: target 1 for a high enough IoU, 0 for a low enough one.

    Proposals in between are unused; if all are, loss and gradient are 0.
    """
    is_positive = iou >= config.positive_iou
    counts = is_positive | (iou <= config.negative_iou)
    kept_logits, targets = logits[counts], is_positive[counts].to(logits.dtype)
    total = binary_cross_entropy_with_logits(kept_logits, targets, reduction="sum")
    return total / torch.clamp(counts.sum(), min=1)


class RefinementLosses(NamedTuple):
    """Scalar losses."""

    total: Float[Tensor, ""]
    """boxes + confidence."""
    boxes: Float[Tensor, ""]
    confidence: Float[Tensor, ""]

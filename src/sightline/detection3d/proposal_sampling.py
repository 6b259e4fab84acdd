"""Sampling of foreground and background proposals to train the second stage."""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Float, Float64, Int64
from torch import Tensor

from sightline.detection3d.target_assignment import Assignment, assign_by_iou, first_largest
from sightline.ops.rotated_iou import pairwise_iou_3d


@dataclass(frozen=True, kw_only=True)
class ProposalSamplingConfig:
    """Settings for sampling a frame's proposals."""

    num_samples: int = 64
    """Number of samples for each frame."""
    max_foreground: int = 32
    """Largest number of foreground samples, if the frame also has background."""
    foreground_iou: float = 0.55
    """3D IoU from which a proposal is foreground."""
    background_iou: float = 0.45
    """3D IoU below which a proposal is background; between the two it is unused."""
    easy_iou: float = 0.05
    """3D IoU below which background is easy."""

    def __post_init__(self) -> None:
        """Checks the numbers."""
        if not 1 <= self.max_foreground <= self.num_samples:
            raise ValueError(
                f"max_foreground must be from 1 to num_samples {self.num_samples}, got "
                f"{self.max_foreground}"
            )
        if not 0 <= self.easy_iou <= self.background_iou <= self.foreground_iou <= 1:
            raise ValueError(
                "easy_iou, background_iou and foreground_iou must rise from 0 to 1, got "
                f"{self.easy_iou}, {self.background_iou}, {self.foreground_iou}"
            )


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
    config: ProposalSamplingConfig = ProposalSamplingConfig(),
    *,
    generator: torch.Generator,
) -> ProposalSamples:
    """Draw exactly `num_samples` proposals of a frame; none if there are no proposals.

    Each proposal is assigned the object of highest IoU (`assign_truths`) and is foreground or
    background by that IoU. In addition, the best proposal of each object (IoU above 0, the first of
    several) is foreground with that object: this adds a sample unless the pair is foreground
    already, and the pair is not background as well.

    - If all are foreground, or all background, they fill all samples.
    - Otherwise up to `max_foreground` are foreground and the rest is background.
    - Background is half easy and half hard if both exist; an odd one is easy.

    If a share is smaller than its pool, it is drawn without repetition; otherwise the whole pool is
    taken and the rest is drawn with repetition. Background has its own share for the sake of the
    confidence: most proposals of a street lie on nothing.

    Args:
        proposals: x, y, z, length, width, height, yaw (LiDAR frame, metres, radians).
        truths: The labelled objects' boxes.
        config: Shares and IoUs.
        generator: Source of all randomness; on the CPU.

    Raises:
        ValueError: A box is not finite or has a negative size.
    """
    iou = pairwise_iou_3d(proposals.double(), truths)
    own = assign_by_iou(iou, truths)
    best = _best_proposals(iou)
    extra = best[~_is_foreground_pair(best, own, config)]
    every = _with_extras(own, extra, iou, truths)
    place = torch.arange(len(proposals) + len(extra), device=iou.device)
    is_extra = place >= len(proposals)
    is_repeated = torch.zeros_like(is_extra)
    is_repeated[extra[own.truth[extra[:, 0]] == extra[:, 1], 0]] = True
    is_background = (every.iou < config.background_iou) & ~is_extra & ~is_repeated
    is_easy = is_background & (every.iou < config.easy_iou)
    pools = (
        (is_extra | (every.iou >= config.foreground_iou)).nonzero()[:, 0],
        is_easy.nonzero()[:, 0],
        (is_background & ~is_easy).nonzero()[:, 0],
    )
    foreground, easy, hard = (len(pool) for pool in pools)
    shares = _shares(foreground, easy, hard, config)
    drawn = [
        _draw(pool, share, generator) for pool, share in zip(pools, shares, strict=True) if share
    ]
    chosen = torch.cat([*drawn, place[:0]])
    source = torch.cat((place[: len(proposals)], extra[:, 0]))
    return ProposalSamples(source[chosen], every.boxes[chosen], every.iou[chosen])


def _best_proposals(
    iou: Float64[Tensor, "num_proposals num_truths"],
) -> Int64[Tensor, "num_found 2"]:
    """Indices of the best proposal and the object, for each overlapped object."""
    if iou.shape[0] == 0:
        return torch.zeros((0, 2), dtype=torch.int64, device=iou.device)
    truth = (iou.amax(dim=0) > 0).nonzero()[:, 0]
    return torch.stack((first_largest(iou.T[truth]), truth), dim=1)


def _is_foreground_pair(
    pairs: Int64[Tensor, "num_pairs 2"], own: Assignment, config: ProposalSamplingConfig
) -> Tensor:
    proposal, truth = pairs.unbind(dim=1)
    return (own.truth[proposal] == truth) & (own.iou[proposal] >= config.foreground_iou)


def _with_extras(
    own: Assignment,
    extra: Int64[Tensor, "num_extra 2"],
    iou: Float64[Tensor, "num_proposals num_truths"],
    truths: Float[Tensor, "num_truths 7"],
) -> Assignment:
    proposal, truth = extra.unbind(dim=1)
    return Assignment(
        torch.cat((own.truth, truth)),
        torch.cat((own.boxes, truths[truth])),
        torch.cat((own.iou, iou[proposal, truth])),
    )


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

"""Refinement of proposals from several axes.

The heading of a distant person is easily wrong. From a proposal with a wrong axis, the second stage
seldom finds the right one; from a proposal with the right axis, it keeps it and predicts a higher
score.
"""

import math
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from sightline.detection3d.axes_config import HeadingHypothesesConfig
from sightline.detection3d.stages import Proposed
from sightline.geometry.transforms import wrap_angle


class TurnedProposals(NamedTuple):
    """Proposals: all unchanged, then some of them again with other axes."""

    proposed: Proposed
    origins: Int64[Tensor, " num_turned"]
    """Index of the original proposal of each row."""
    axes: Int64[Tensor, " num_turned"]
    """Axis number of each row; 0: the proposal's own axis."""


def turn_to_axes(
    proposed: Proposed, is_turned: Bool[Tensor, " num_proposals"], number: int
) -> TurnedProposals:
    """Add copies of some proposals, for `number` axes evenly spread over half a turn."""
    count, device = len(proposed.boxes), proposed.boxes.device
    again = is_turned.nonzero()[:, 0]
    axes = torch.arange(1, number, device=device).repeat_interleave(len(again))
    origins = torch.cat((torch.arange(count, device=device), again.repeat(number - 1)))
    axes = torch.cat((torch.zeros(count, dtype=torch.int64, device=device), axes))
    boxes, classes, scores = (values[origins] for values in proposed[:3])
    boxes[:, 6] = wrap_angle(boxes[:, 6] + axes.to(boxes.dtype) * (math.pi / number))
    turned = Proposed(boxes, classes, scores, proposed.features)
    return TurnedProposals(turned, origins, axes)


def best_headings(
    scores: Float[Tensor, " num_turned"], turned: TurnedProposals, config: HeadingHypothesesConfig
) -> Int64[Tensor, " num_proposals"]:
    """Return the row of the best refined box for each original proposal.

    Args:
        scores: Second-stage scores of the refined rows.
        turned: The proposals before refinement.
        config: Gain that another axis needs.
    """
    is_own = turned.axes == 0
    worth = torch.where(is_own, scores, scores / (1 + config.least_gain))
    table = worth.new_full((int(turned.axes.max()) + 1, int(is_own.sum())), -math.inf)
    places = torch.zeros_like(table, dtype=torch.int64)
    table[turned.axes, turned.origins] = worth
    places[turned.axes, turned.origins] = torch.arange(len(scores), device=scores.device)
    best = table.argmax(dim=0, keepdim=True)
    return places.gather(0, best)[0]

"""Repeated passes of the second stage, and the result of several passes."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Bool, Int64
from torch import Tensor

from sightline.detection3d.stages import Proposed, Refined, SecondStage, Sweep, autocast_disabled
from sightline.detection3d.views import Run
from sightline.geometry.transforms import wrap_angle

POINT_SEED = 0  # for drawing points around proposals: results are reproducible


class RefinementState(NamedTuple):
    """State of boxes between second-stage passes."""

    proposed: Proposed
    """Start of the next pass; the scores are still the first stage's."""
    answers: tuple[Refined, ...] = ()
    """Outputs of the passes so far; their rows match `proposed`."""

    def kept(self, places: Int64[Tensor, " num_kept"]) -> "RefinementState":
        """Select some of the boxes."""
        boxes, classes, scores, features = self.proposed
        proposed = Proposed(boxes[places], classes[places], scores[places], features)
        answers = tuple(Refined(*(rows[places] for rows in each)) for each in self.answers)
        return RefinementState(proposed, answers)


def run_passes(
    second: SecondStage, sweep: Sweep, passed: RefinementState, ask: Run, number: int
) -> RefinementState:
    """Run `number` further passes, each from the output of the one before, while boxes remain.

    Args:
        second: The stage.
        sweep: The first stage's input.
        passed: Start of the passes.
        ask: Runs the stage's module.
        number: Number of passes.
    """
    for _ in range(number):
        if not len(passed.proposed.boxes):
            break
        with autocast_disabled(sweep):
            regions = second.regions(sweep, passed.proposed, seed=POINT_SEED)
        passed = passed.kept(regions.places)
        answer = Refined(regions.boxes, regions.scores, torch.zeros_like(regions.scores))
        if len(regions.places):
            output = ask(regions.inputs)
            with autocast_disabled(sweep):
                answer = second.refine(output, regions)
        proposed = passed.proposed._replace(boxes=answer.boxes)
        passed = RefinementState(proposed, (*passed.answers, answer))
    return passed


def answer_of_passes(answers: Sequence[Refined], is_mean: Bool[Tensor, " num_boxes"]) -> Refined:
    """Select the last pass's result, or for some boxes the mean of the first and last pass."""
    last, mean = answers[-1], mean_answer(answers[0], answers[-1])
    return Refined(
        torch.where(is_mean[:, None], mean.boxes, last.boxes),
        torch.where(is_mean, mean.scores, last.scores),
        torch.where(is_mean, mean.front_logits, last.front_logits),
    )


def mean_answer(*answers: Refined) -> Refined:
    """Average several results for the same boxes.

    Centres and scores are arithmetic means, sizes geometric means. The axis is the mean by sine and
    cosine of twice its angle; the front comes from the mean of the log-odds.
    """
    boxes, scores, front_logits = (torch.stack(each) for each in zip(*answers, strict=True))
    centers, sizes = boxes[..., :3].mean(dim=0), boxes[..., 3:6].log().mean(dim=0).exp()
    yaws = boxes[..., 6]
    axes = torch.atan2((2 * yaws).sin().mean(dim=0), (2 * yaws).cos().mean(dim=0)) / 2
    is_ahead = (yaws - axes).cos() >= 0
    front = torch.where(is_ahead, front_logits, -front_logits).mean(dim=0)
    mean_yaws = wrap_angle(axes + torch.where(front >= 0, 0.0, math.pi))
    mean_boxes = torch.cat((centers, sizes, mean_yaws[:, None]), dim=1)
    return Refined(mean_boxes, scores.mean(dim=0), front.abs())

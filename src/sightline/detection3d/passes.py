"""The second stage, applied again and again, and what is answered of its passes."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Int64
from torch import Tensor

from sightline.detection3d.stages import Proposed, Refined, SecondStage, Sweep, full_precision
from sightline.detection3d.views import Run
from sightline.geometry.transforms import wrap_angle

_SEED = 0  # of the points that are drawn around proposals: a sweep is always answered alike


class Passed(NamedTuple):
    """Boxes on their way through the second stage."""

    proposed: Proposed
    """Where the next pass starts; the scores are still the first stage's."""
    answers: tuple[Refined, ...] = ()
    """Of each pass so far; their rows are those of `proposed`."""

    def kept(self, places: Int64[Tensor, " num_kept"]) -> "Passed":
        """Some of the boxes."""
        boxes, classes, scores, features = self.proposed
        proposed = Proposed(boxes[places], classes[places], scores[places], features)
        answers = tuple(Refined(each.boxes[places], each.scores[places]) for each in self.answers)
        return Passed(proposed, answers)


def run_passes(second: SecondStage, sweep: Sweep, passed: Passed, ask: Run, number: int) -> Passed:
    """So many passes more, each from what the one before gave, as long as there are boxes.

    Args:
        second: The stage.
        sweep: As the proposals' first stage saw it.
        passed: Where to start.
        ask: Runs the stage's module.
        number: Of passes.
    """
    for _ in range(number):
        if not len(passed.proposed.boxes):
            break
        with full_precision(sweep):
            regions = second.regions(sweep, passed.proposed, seed=_SEED)
        passed = passed.kept(regions.places)
        answer = Refined(regions.boxes, regions.scores)
        if len(regions.places):
            output = ask(regions.inputs)
            with full_precision(sweep):
                answer = second.refine(output, regions)
        proposed = passed.proposed._replace(boxes=answer.boxes)
        passed = Passed(proposed, (*passed.answers, answer))
    return passed


def mean_answer(answers: Sequence[Refined]) -> Refined:
    """The mean of what passes give for the same boxes; a single one's answer as it is.

    The means of the centres and of the scores, the geometric means of the sizes, and the mean
    axis, by sine and cosine of twice its angle, with the front where the last pass has it.
    """
    if len(answers) == 1:
        return answers[0]
    boxes = torch.stack([each.boxes for each in answers])
    centers, sizes = boxes[..., :3].mean(dim=0), boxes[..., 3:6].log().mean(dim=0).exp()
    twice, last = 2 * boxes[..., 6:], boxes[-1, :, 6:]
    axes = torch.atan2(twice.sin().mean(dim=0), twice.cos().mean(dim=0)) / 2
    yaws = axes + torch.where((axes - last).cos() >= 0, 0.0, math.pi)
    scores = torch.stack([each.scores for each in answers]).mean(dim=0)
    return Refined(torch.cat((centers, sizes, wrap_angle(yaws)), dim=-1), scores)

"""3D detector with one or two stages, and detection in a sweep.

The second stage may run in several passes, and refine proposals from several axes. The heading of a
distant person is easily wrong. From a proposal with a wrong axis, the second stage seldom finds the
right one; from a proposal with the right axis, it keeps it and predicts a higher score.
"""

import math
from collections.abc import Sequence
from functools import partial
from typing import Final, NamedTuple, cast

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor, nn

from sightline.detection3d.config import Detection3DConfig, HeadingHypothesesConfig
from sightline.detection3d.pillars.regions import RegionStage
from sightline.detection3d.pillars.stage import PillarProposals
from sightline.detection3d.points.proposals import PointProposals
from sightline.detection3d.points.refinement import PointRefinement
from sightline.detection3d.stages import (
    FirstStage,
    Proposed,
    Refined,
    Run,
    SecondStage,
    Stage,
    autocast_disabled,
    mean_over_joined_views,
    mean_over_views,
)
from sightline.detection3d.suppression import suppress_boxes
from sightline.detection3d.sweeps import Sweep
from sightline.geometry.boxes3d import Boxes3D
from sightline.geometry.transforms import wrap_angle
from sightline.structures.predictions import Detections3D

POINT_SEED: Final = 0  # for drawing points around proposals: results are reproducible


class Detector3D(nn.Module):
    """The stages, each a module with the name of its settings; see `propose` and `refine`."""

    def __init__(self, config: Detection3DConfig) -> None:
        super().__init__()
        self.config = config
        self.class_names = tuple(entry.name for entry in config.classes)
        self.first_name, self.second_name = "points", None
        if config.pillars is not None:
            self.first_name = "pillars"
            self.pillars = PillarProposals(config.pillars, config.centers)
        elif config.points is not None:
            choices = config.proposals, config.training_proposals
            self.points = PointProposals(config.points, *choices)
        if config.regions is not None:
            self.second_name = "regions"
            self.regions = RegionStage(config.regions)
        elif config.refinement is not None:
            self.second_name = "refinement"
            self.refinement = PointRefinement(config.refinement, config.pooling)

    @property
    def first(self) -> FirstStage:
        """First stage: sweeps to proposals."""
        return cast("FirstStage", self.get_submodule(self.first_name))

    @property
    def second(self) -> SecondStage | None:
        """Second stage: proposals to refined boxes."""
        name = self.second_name
        return None if name is None else cast("SecondStage", self.get_submodule(name))

    def runner(self, stage: Stage, run: Run | None, *, in_use: bool) -> Run:
        """Run a stage by `run` or by PyTorch; in use on both views if the settings require it."""
        views = stage.views if in_use and self.config.flip_test else stage.views[:1]
        average = mean_over_joined_views if stage is self.second else mean_over_views
        return partial(average, run or (lambda inputs: stage(**inputs)), views=views)

    def is_named(
        self, classes: Int64[Tensor, " num_boxes"], names: Sequence[str]
    ) -> Bool[Tensor, " num_boxes"]:
        """Mask of the boxes of the named classes."""
        places = [self.class_names.index(name) for name in names]
        return torch.isin(classes, classes.new_tensor(places))

    def as_detections(
        self,
        boxes: Float[Tensor, "num_boxes 7"],
        classes: Int64[Tensor, " num_boxes"],
        scores: Float[Tensor, " num_boxes"],
    ) -> Detections3D:
        """Convert boxes from the sweep's frame to the labels' frame."""
        label_boxes = boxes.detach().cpu().clone()
        label_boxes[:, 2] -= self.config.input.height_offset_m
        return Detections3D(
            class_names=tuple(self.class_names[index] for index in classes.cpu().tolist()),
            boxes=Boxes3D(label_boxes),
            scores=scores.detach().cpu(),
        )


def propose(
    detector: Detector3D,
    sweep: Sweep,
    run: Run | None = None,
    *,
    training: Sequence[bool] = (False,),
    in_use: bool = True,
) -> list[Proposed]:
    """Compute the first stage's proposals for a sweep, one result per `training` entry.

    A sweep without points has none. `run` runs the stage (None: PyTorch, on the stage's device);
    `training` says of each result whether it is for training a second stage, `in_use` whether the
    inference-only setting `flip_test` applies.
    """
    if not len(sweep):
        none = torch.zeros(0, dtype=torch.int64, device=sweep.device)
        return [Proposed(sweep.new_zeros(0, 7), none, sweep.new_zeros(0)) for _ in training]
    first = detector.first
    output = detector.runner(first, run, in_use=in_use)(first.inputs([sweep]))
    with autocast_disabled(sweep):
        return [first.propose(output, [sweep], training=each)[0] for each in training]


class RefinementState(NamedTuple):
    """State of boxes between second-stage passes."""

    proposed: Proposed
    """Start of the next pass; the scores are still the first stage's."""
    refined: tuple[Refined, ...] = ()
    """Outputs of the passes so far; their rows match `proposed`."""

    def select(self, places: Int64[Tensor, " num_kept"]) -> "RefinementState":
        """Select some of the boxes."""
        refined = tuple(Refined(*(rows[places] for rows in each)) for each in self.refined)
        return RefinementState(self.proposed.select(places), refined)


def refine(
    detector: Detector3D,
    sweep: Sweep,
    proposed: Proposed,
    run: Run | None = None,
    *,
    in_use: bool = True,
) -> Detections3D:
    """Refine proposals where there is a second stage, then suppress overlapping boxes.

    Detections are in the labels' frame, by descending score. Arguments are as in `propose`;
    `in_use` applies `axes`, too.
    """
    boxes, classes, scores, _ = proposed
    second, config = detector.second, detector.config
    if second is not None and len(boxes):
        run_second, done = detector.runner(second, run, in_use=in_use), 0
        state, axes = RefinementState(proposed), config.axes
        if in_use and axes is not None:
            is_turned, done = detector.is_named(classes, axes.class_names), axes.passes
            turned = turn_to_axes(proposed, is_turned, axes.number)
            state = run_passes(second, sweep, RefinementState(turned.proposed), run_second, done)
            state = state.select(best_headings(state.refined[-1].scores, turned, axes))
        state = run_passes(second, sweep, state, run_second, second.passes - done)
        classes = state.proposed.classes
        is_mean = detector.is_named(classes, second.mean_with_first)
        boxes, scores, _ = combine_passes(state.refined, is_mean)
    with autocast_disabled(sweep):
        kept = suppress_boxes(boxes, scores, config.suppression, labels=classes)
    return detector.as_detections(boxes[kept], classes[kept], scores[kept])


def run_passes(
    second: SecondStage, sweep: Sweep, state: RefinementState, run: Run, number: int
) -> RefinementState:
    """Run `number` further passes by `run`, each from the output of the one before."""
    for _ in range(number):
        if not len(state.proposed.boxes):
            break
        with autocast_disabled(sweep):
            regions = second.regions(sweep, state.proposed, seed=POINT_SEED)
        state = state.select(regions.places)
        refined = Refined(regions.boxes, regions.scores, torch.zeros_like(regions.scores))
        if len(regions.places):
            output = run(regions.inputs)
            with autocast_disabled(sweep):
                refined = second.refine(output, regions)
        proposed = state.proposed._replace(boxes=refined.boxes)
        state = RefinementState(proposed, (*state.refined, refined))
    return state


def combine_passes(refined: Sequence[Refined], is_mean: Bool[Tensor, " num_boxes"]) -> Refined:
    """Select the last pass's result, or for some boxes the mean of the first and last pass."""
    last, mean = refined[-1], mean_refined(refined[0], refined[-1])
    return Refined(
        torch.where(is_mean[:, None], mean.boxes, last.boxes),
        torch.where(is_mean, mean.scores, last.scores),
        torch.where(is_mean, mean.front_logits, last.front_logits),
    )


def mean_refined(*refined: Refined) -> Refined:
    """Average several results for the same boxes.

    Centres and scores are arithmetic means, sizes geometric means. The axis is the mean by sine and
    cosine of twice its angle; the front comes from the mean of the log-odds.
    """
    boxes, scores, front_logits = (torch.stack(each) for each in zip(*refined, strict=True))
    centers, sizes = boxes[..., :3].mean(dim=0), boxes[..., 3:6].log().mean(dim=0).exp()
    yaws = boxes[..., 6]
    axes = torch.atan2((2 * yaws).sin().mean(dim=0), (2 * yaws).cos().mean(dim=0)) / 2
    is_ahead = (yaws - axes).cos() >= 0
    front = torch.where(is_ahead, front_logits, -front_logits).mean(dim=0)
    mean_yaws = wrap_angle(axes + torch.where(front >= 0, 0.0, math.pi))
    mean_boxes = torch.cat((centers, sizes, mean_yaws[:, None]), dim=1)
    return Refined(mean_boxes, scores.mean(dim=0), front.abs())


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
    turned = proposed.select(origins)
    boxes = turned.boxes
    boxes[:, 6] = wrap_angle(boxes[:, 6] + axes.to(boxes.dtype) * (math.pi / number))
    return TurnedProposals(turned, origins, axes)


def best_headings(
    scores: Float[Tensor, " num_turned"], turned: TurnedProposals, config: HeadingHypothesesConfig
) -> Int64[Tensor, " num_proposals"]:
    """Return the row of the best-scored refined box for each original proposal."""
    is_own = turned.axes == 0
    adjusted = torch.where(is_own, scores, scores / (1 + config.least_gain))
    table = adjusted.new_full((int(turned.axes.max()) + 1, int(is_own.sum())), -math.inf)
    places = torch.zeros_like(table, dtype=torch.int64)
    table[turned.axes, turned.origins] = adjusted
    places[turned.axes, turned.origins] = torch.arange(len(scores), device=scores.device)
    best = table.argmax(dim=0, keepdim=True)
    return places.gather(0, best)[0]

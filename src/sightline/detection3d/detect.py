"""From a sweep to detections, by a detector's stages."""

from collections.abc import Sequence
from functools import partial

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from sightline.detection3d.model import Detector3D
from sightline.detection3d.stages import (
    FirstStage,
    Proposed,
    SecondStage,
    Sweep,
    full_precision,
)
from sightline.detection3d.suppression import suppress_boxes
from sightline.detection3d.views import Run, View, answer_of_views
from sightline.geometry.boxes3d import Boxes3D
from sightline.structures.predictions import Detections3D

_SEED = 0  # of the points that are drawn around proposals: a sweep is always answered alike


def propose(
    detector: Detector3D,
    sweep: Sweep,
    run: Run | None = None,
    *,
    training: Sequence[bool] = (False,),
    flip_test: bool | None = None,
) -> list[Proposed]:
    """The first stage's proposals for a sweep of one point or more, in as many ways as asked for.

    Args:
        detector: The stages.
        sweep: As `sweeps` prepares it.
        run: Runs the stage's module. None: PyTorch, where the module is.
        training: For each way, whether they are for a second stage's training.
        flip_test: Whether it sees the sweep mirrored, too. None: as the settings say.
    """
    first = detector.first
    inputs = first.inputs([sweep])
    views = _views(detector, first, flip_test=flip_test)
    output = answer_of_views(run or _here(first), inputs, views)
    with full_precision(sweep):
        return [first.propose(output, [sweep], training=each)[0] for each in training]


def refine(
    detector: Detector3D,
    sweep: Sweep,
    proposed: Proposed,
    run: Run | None = None,
    *,
    flip_test: bool | None = None,
) -> Detections3D:
    """What is answered of proposals: refined where there is a second stage, then suppressed.

    Args:
        detector: The stages.
        sweep: As the proposals' first stage saw it.
        proposed: What it proposed.
        run: Runs the second stage's module. None: PyTorch, where the module is.
        flip_test: Whether it sees regions turned round, too. None: as the settings say.

    Returns:
        The surest first, in the labels' frame.
    """
    scores, config = proposed.scores, detector.config
    if detector.second is not None:
        views = _views(detector, detector.second, flip_test=flip_test)
        ask = partial(answer_of_views, run or _here(detector.second), views=views)
        proposed, scores = _all_passes(detector.second, sweep, proposed, ask)
    with full_precision(sweep):
        kept = suppress_boxes(proposed.boxes, scores, config.suppression, labels=proposed.classes)
    return as_detections(detector, proposed.boxes[kept], proposed.classes[kept], scores[kept])


def _all_passes(
    second: SecondStage, sweep: Sweep, proposed: Proposed, ask: Run
) -> tuple[Proposed, Float[Tensor, " num_boxes"]]:
    """The refined boxes with the proposals' scores, where each pass starts; the last scores."""
    scores = proposed.scores
    for _ in range(second.passes):
        if not len(proposed.boxes):
            break
        with full_precision(sweep):
            regions = second.regions(sweep, proposed, seed=_SEED)
        boxes, scores, classes = regions.boxes, regions.scores, proposed.classes[regions.places]
        if len(boxes):
            output = ask(regions.inputs)
            with full_precision(sweep):
                boxes, scores = second.refine(output, regions)
        proposed = Proposed(boxes, classes, regions.scores, proposed.features)
    return proposed, scores


def as_detections(
    detector: Detector3D,
    boxes: Float[Tensor, "num_boxes 7"],
    classes: Int64[Tensor, " num_boxes"],
    scores: Float[Tensor, " num_boxes"],
) -> Detections3D:
    """Boxes of the sweep's frame in the labels'."""
    answered = boxes.detach().cpu().clone()
    answered[:, 2] -= detector.config.input.height_offset_m
    return Detections3D(
        class_names=tuple(detector.class_names[index] for index in classes.cpu().tolist()),
        boxes=Boxes3D(answered),
        scores=scores.detach().cpu(),
    )


def nothing_proposed(sweep: Sweep) -> Proposed:
    """Of a sweep without points."""
    none = torch.zeros(0, dtype=torch.int64, device=sweep.device)
    return Proposed(sweep.new_zeros(0, 7), none, sweep.new_zeros(0))


def _here(stage: FirstStage | SecondStage) -> Run:
    """Runs a stage by PyTorch, where its module is."""
    return lambda inputs: stage(**inputs)


def _views(
    detector: Detector3D, stage: FirstStage | SecondStage, *, flip_test: bool | None
) -> tuple[View, ...]:
    is_asked = detector.config.flip_test if flip_test is None else flip_test
    return stage.views if is_asked else stage.views[:1]

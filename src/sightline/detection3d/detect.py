"""Detection in a sweep by a detector's stages."""

from collections.abc import Sequence
from functools import partial

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from sightline.detection3d.axes import best_headings, turn_to_axes
from sightline.detection3d.axes_config import HeadingHypothesesConfig
from sightline.detection3d.model import Detector3D
from sightline.detection3d.passes import RefinementState, answer_of_passes, run_passes
from sightline.detection3d.stages import (
    FirstStage,
    Proposed,
    SecondStage,
    Sweep,
    autocast_disabled,
)
from sightline.detection3d.suppression import suppress_boxes
from sightline.detection3d.views import Run, View, answer_of_views
from sightline.geometry.boxes3d import Boxes3D
from sightline.structures.predictions import Detections3D


def propose(
    detector: Detector3D,
    sweep: Sweep,
    run: Run | None = None,
    *,
    training: Sequence[bool] = (False,),
    in_use: bool = True,
) -> list[Proposed]:
    """Compute the first stage's proposals for a sweep with points, one result per `training` entry.

    Args:
        detector: The stages.
        sweep: Output of `sweeps`.
        run: Runs the stage's module. None: PyTorch, on the module's device.
        training: For each result, whether the proposals are for training a second stage.
        in_use: Whether to apply the inference-only setting `flip_test`.
    """
    first = detector.first
    inputs = first.inputs([sweep])
    views = _views(detector, first, in_use=in_use)
    output = answer_of_views(run or _here(first), inputs, views)
    with autocast_disabled(sweep):
        return [first.propose(output, [sweep], training=each)[0] for each in training]


def refine(
    detector: Detector3D,
    sweep: Sweep,
    proposed: Proposed,
    run: Run | None = None,
    *,
    in_use: bool = True,
) -> Detections3D:
    """Refine proposals where there is a second stage, then suppress overlapping boxes.

    Args:
        detector: The stages.
        sweep: The first stage's input.
        proposed: The first stage's proposals.
        run: Runs the second stage's module. None: PyTorch, on the module's device.
        in_use: Whether to apply the inference-only settings `flip_test` and `axes`.

    Returns:
        Detections by descending score, in the labels' frame.
    """
    boxes, classes, scores, _ = proposed
    second, config = detector.second, detector.config
    if second is not None:
        views = _views(detector, second, in_use=in_use)
        ask = partial(answer_of_views, run or _here(second), views=views)
        passed = _all_passes(detector, sweep, proposed, ask, config.axes if in_use else None)
        classes = passed.proposed.classes
        if passed.answers:
            is_mean = _is_named(detector, classes, second.mean_with_first)
            boxes, scores, _ = answer_of_passes(passed.answers, is_mean)
    with autocast_disabled(sweep):
        kept = suppress_boxes(boxes, scores, config.suppression, labels=classes)
    return as_detections(detector, boxes[kept], classes[kept], scores[kept])


def _all_passes(
    detector: Detector3D,
    sweep: Sweep,
    proposed: Proposed,
    ask: Run,
    axes: HeadingHypothesesConfig | None,
) -> RefinementState:
    """Run all passes; with `axes`, keep the best-scored axis of each proposal."""
    second = detector.second
    assert second is not None, "there is something to refine by"
    if axes is None or not len(proposed.boxes):
        return run_passes(second, sweep, RefinementState(proposed), ask, second.passes)
    is_turned = _is_named(detector, proposed.classes, axes.class_names)
    turned = turn_to_axes(proposed, is_turned, axes.number)
    passed = run_passes(second, sweep, RefinementState(turned.proposed), ask, axes.passes)
    surest = passed.kept(best_headings(passed.answers[-1].scores, turned, axes))
    return run_passes(second, sweep, surest, ask, second.passes - axes.passes)


def _is_named(
    detector: Detector3D, classes: Int64[Tensor, " num_boxes"], names: Sequence[str]
) -> Bool[Tensor, " num_boxes"]:
    """Mask of the boxes of the named classes."""
    places = [detector.class_names.index(name) for name in names]
    return torch.isin(classes, classes.new_tensor(places))


def as_detections(
    detector: Detector3D,
    boxes: Float[Tensor, "num_boxes 7"],
    classes: Int64[Tensor, " num_boxes"],
    scores: Float[Tensor, " num_boxes"],
) -> Detections3D:
    """Convert boxes from the sweep's frame to the labels' frame."""
    answered = boxes.detach().cpu().clone()
    answered[:, 2] -= detector.config.input.height_offset_m
    return Detections3D(
        class_names=tuple(detector.class_names[index] for index in classes.cpu().tolist()),
        boxes=Boxes3D(answered),
        scores=scores.detach().cpu(),
    )


def nothing_proposed(sweep: Sweep) -> Proposed:
    """Empty proposals, for a sweep without points."""
    none = torch.zeros(0, dtype=torch.int64, device=sweep.device)
    return Proposed(sweep.new_zeros(0, 7), none, sweep.new_zeros(0))


def _here(stage: FirstStage | SecondStage) -> Run:
    """Run a stage by PyTorch, on its module's device."""
    return lambda inputs: stage(**inputs)


def _views(
    detector: Detector3D, stage: FirstStage | SecondStage, *, in_use: bool
) -> tuple[View, ...]:
    return stage.views if in_use and detector.config.flip_test else stage.views[:1]

"""From a sweep to detections, by a detector's stages."""

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from sightline.detection3d.model import Detector3D
from sightline.detection3d.proposals import ProposalConfig
from sightline.detection3d.stages import Proposed, Run, Sweep
from sightline.detection3d.suppression import suppress_boxes
from sightline.geometry.boxes3d import Boxes3D
from sightline.structures.predictions import Detections3D

_SEED = 0  # of the points that are drawn around proposals: a sweep is always answered alike


def propose(
    detector: Detector3D,
    sweep: Sweep,
    configs: Sequence[ProposalConfig],
    run: Run | None = None,
) -> list[Proposed]:
    """The first stage's proposals for a sweep of one point or more, in as many ways as asked for.

    Args:
        detector: The stages.
        sweep: As `sweeps` prepares it.
        configs: How boxes become proposals.
        run: Runs the stage's module. None: PyTorch, where the module is.
    """
    first = detector.first
    inputs = first.inputs([sweep])
    output = _here(first, inputs) if run is None else run(inputs)
    return [first.propose(output, [sweep], config)[0] for config in configs]


def refine(
    detector: Detector3D, sweep: Sweep, proposed: Proposed, run: Run | None = None
) -> Detections3D:
    """What is answered of proposals: refined where there is a second stage, then suppressed.

    Args:
        detector: The stages.
        sweep: As the proposals' first stage saw it.
        proposed: What it proposed.
        run: Runs the second stage's module. None: PyTorch, where the module is.

    Returns:
        The surest first, in the labels' frame.
    """
    boxes, classes, scores, features = proposed
    second = detector.second
    for _ in range(0 if second is None else second.passes):
        assert second is not None, "there are passes"
        if not len(boxes):
            break
        regions = second.regions(sweep, features, boxes, seed=_SEED)
        classes = classes[regions.places]
        if not len(classes):
            boxes, scores = boxes[:0], scores[:0]
            break
        output = _here(second, regions.inputs) if run is None else run(regions.inputs)
        boxes, scores = second.refine(output, regions)
    kept = suppress_boxes(boxes, scores, detector.config.suppression, labels=classes).cpu()
    answered = boxes.detach().cpu()[kept]
    answered[:, 2] -= detector.config.input.height_offset_m
    return Detections3D(
        class_names=tuple(detector.class_names[index] for index in classes.cpu()[kept].tolist()),
        boxes=Boxes3D(answered),
        scores=scores.detach().cpu()[kept],
    )


def nothing_proposed(sweep: Sweep) -> Proposed:
    """Of a sweep without points."""
    none = torch.zeros(0, dtype=torch.int64, device=sweep.device)
    return Proposed(sweep.new_zeros(0, 7), none, sweep.new_zeros(0))


def _here(
    stage: Any,  # noqa: ANN401 - either protocol
    inputs: Mapping[str, Tensor],
) -> Any:  # noqa: ANN401 - the stage's own output
    return stage(**inputs)

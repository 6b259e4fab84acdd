"""Base of the detectors' stages, and the types between them.

A stage is the exported part: named tensors in, a NamedTuple out. Searches, draws and suppression,
which other engines do not support, come before it (`inputs`, `regions`) and after it.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple

import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn

from sightline.detection3d.config import Detection3DLossConfig
from sightline.detection3d.sweeps import Sweep, SweepTruth
from sightline.structures.batch import Losses

Run = Callable[[Mapping[str, Tensor]], Any]
"""Runner of a stage, here or by another engine; returns its NamedTuple."""


def autocast_disabled(near: Tensor) -> torch.autocast:
    """Switch automatic mixed precision off on a tensor's device: it is for networks alone.

    Boxes are rotated by matrix products, which it would round to bfloat16: decimetres at 60 m.
    """
    return torch.autocast(near.device.type, enabled=False)


class StageView(NamedTuple):
    """View of the flip test: a transform of a stage's inputs with a known effect on its output."""

    change: Callable[[Mapping[str, Tensor]], Mapping[str, Tensor]]
    """Transform of the inputs."""
    change_back: Callable[[Any], Any]
    """Inverse transform of the stage's NamedTuple."""


def _same(given: Any) -> Any:  # noqa: ANN401 - inputs or an output
    return given


UNCHANGED: Final = StageView(_same, _same)


def mean_over_views(run: Run, inputs: Mapping[str, Tensor], views: Sequence[StageView]) -> Any:  # noqa: ANN401 - the stage's NamedTuple
    """Run a stage on one or more views, and average the outputs, each transformed back.

    The output of a single view is returned unchanged.
    """
    return _mean([view.change_back(run(view.change(inputs))) for view in views])


def mean_over_joined_views(
    run: Run, inputs: Mapping[str, Tensor], views: Sequence[StageView]
) -> Any:  # noqa: ANN401 - the stage's NamedTuple
    """Average over views as `mean_over_views`, by one run for all, of stages that take rows.

    Engines take a fixed number of rows at a time, so a few rows of two views fit into one run.
    """
    changed = [view.change(inputs) for view in views]
    output = run({name: torch.cat([each[name] for each in changed]) for name in inputs})
    parts = zip(*(values.chunk(len(views)) for values in output), strict=True)
    made = type(output)
    return _mean([view.change_back(made(*part)) for view, part in zip(views, parts, strict=True)])


def _mean(outputs: Sequence[Any]) -> Any:  # noqa: ANN401 - the stage's NamedTuple
    """Average NamedTuples of tensors; a single one is returned unchanged."""
    if len(outputs) == 1:
        return outputs[0]
    means = (torch.stack(values).mean(dim=0) for values in zip(*outputs, strict=True))
    return type(outputs[0])(*means)


class Proposed(NamedTuple):
    """Output of a first stage for a sweep."""

    boxes: Float[Tensor, "num_proposals 7"]
    """x, y, z, length, width, height, yaw (frame of the sweep, metres, radians)."""
    classes: Int64[Tensor, " num_proposals"]
    """Indices into the detector's classes."""
    scores: Float[Tensor, " num_proposals"]
    """Confidence, 0 to 1."""
    features: Float[Tensor, "num_points channels"] | None = None
    """Features of the sweep's points; None if the design has none."""

    def select(self, rows: Tensor) -> "Proposed":
        """Select proposals by a mask or by indices; all features stay."""
        return Proposed(self.boxes[rows], self.classes[rows], self.scores[rows], self.features)


class Regions(NamedTuple):
    """Proposals with the points around them: input of a second stage."""

    places: Int64[Tensor, " num_rois"]
    """Indices into all proposals."""
    boxes: Float[Tensor, "num_rois 7"]
    """Boxes of the proposals."""
    scores: Float[Tensor, " num_rois"]
    """Scores of the proposals."""
    inputs: dict[str, Tensor]
    """Inputs of the stage; their first axis counts the regions."""


class Refined(NamedTuple):
    """Refined boxes of regions."""

    boxes: Float[Tensor, "num_rois 7"]
    """x, y, z, length, width, height, yaw (frame of the sweep, metres, radians)."""
    scores: Float[Tensor, " num_rois"]
    """Confidence, 0 to 1."""
    front_logits: Float[Tensor, " num_rois"]
    """Log-odds that the front is at the box's front end; 0 if the design does not predict it."""


class Stage(nn.Module, ABC):
    """Stage of a detector."""

    output_type: Callable[..., tuple[Any, ...]]
    """NamedTuple of the output."""
    views: tuple[StageView, ...] = (UNCHANGED,)
    """Views of the flip test; the first is the unchanged input."""
    network: nn.Module

    def forward(self, **inputs: Tensor) -> Any:  # noqa: ANN401 - of `output_type`
        """Run the network on named inputs."""
        return self.network(**inputs)


class FirstStage(Stage):
    """Sweeps to proposals."""

    feature_channels = 0
    """Number of features for each point."""

    @abstractmethod
    def inputs(self, sweeps: Sequence[Sweep]) -> dict[str, Tensor]:
        """Make the stage's inputs for sweeps with at least one point each."""

    @abstractmethod
    def propose(
        self,
        output: Any,  # noqa: ANN401 - of `output_type`
        sweeps: Sequence[Sweep],
        *,
        training: bool,
    ) -> tuple[Proposed, ...]:
        """Compute each sweep's proposals, for inference or second-stage training; no gradient."""

    @abstractmethod
    def losses(
        self,
        output: Any,  # noqa: ANN401 - of `output_type`
        sweeps: Sequence[Sweep],
        truths: Sequence[SweepTruth],
        config: Detection3DLossConfig,
    ) -> Losses:
        """Compute the training losses."""


class SecondStage(Stage):
    """Proposals to refined boxes."""

    passes = 1
    """Number of passes, each from the output of the one before."""
    mean_with_first: tuple[str, ...] = ()
    """Classes whose result is the mean of the first and last pass, not the last."""

    @abstractmethod
    def regions(self, sweep: Sweep, proposed: Proposed, *, seed: int) -> Regions:
        """Draw the points around proposals; useless proposals may be dropped."""

    @abstractmethod
    def examples(
        self,
        sweep: Sweep,
        proposed: Proposed,
        truth: SweepTruth,
        config: Detection3DLossConfig,
        *,
        seed: int,
    ) -> tuple[Regions, tuple[Tensor, ...]]:
        """Draw regions of a sweep for training, with their targets.

        The targets are a NamedTuple of the stage's own; the first axis of each tensor counts the
        regions.
        """

    @abstractmethod
    def refine(
        self,
        output: Any,  # noqa: ANN401 - of `output_type`
        regions: Regions,
    ) -> Refined:
        """Decode boxes for regions, with their scores."""

    @abstractmethod
    def losses(
        self,
        output: Any,  # noqa: ANN401 - of `output_type`
        regions: Regions,
        targets: Any,  # noqa: ANN401 - as `examples` gives it
        config: Detection3DLossConfig,
    ) -> Losses:
        """Compute the training losses."""

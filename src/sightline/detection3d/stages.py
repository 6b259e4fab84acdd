"""Common interface of the detectors' stages.

A stage's module is the exported part: named tensors in, a NamedTuple out. Searches, draws and
suppression, which other engines do not support, come before it (`inputs`) and after it.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import torch
from jaxtyping import Float, Float32, Int64
from torch import Tensor

from sightline.detection3d.loss_config import Detection3DLossConfig
from sightline.detection3d.targets import SweepTruth
from sightline.detection3d.views import View
from sightline.structures.batch import Losses

Sweep = Float32[Tensor, "_ 4"]
"""LiDAR frame, raised by the settings' height offset: x, y, z [m], reflectance."""


def autocast_disabled(near: Tensor) -> torch.autocast:
    """Switch automatic mixed precision off on a tensor's device: it is for networks alone.

    Boxes are rotated by matrix products, which it would round to bfloat16: decimetres at 60 m.
    """
    return torch.autocast(near.device.type, enabled=False)


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


@runtime_checkable  # for beartype, which checks arguments under pytest
class FirstStage(Protocol):
    """Interface of a first stage: sweeps to proposals; an `nn.Module`."""

    @property
    def feature_channels(self) -> int:
        """Number of features for each point; 0: none."""
        ...

    @property
    def max_proposals(self) -> int:
        """Largest number of proposals for a sweep at inference."""
        ...

    @property
    def output_type(self) -> Callable[..., tuple[Any, ...]]:
        """Type of the module's output."""
        ...

    @property
    def views(self) -> tuple[View, ...]:
        """Views of the flip test; the first is the unchanged scene."""
        ...

    def __call__(self, **inputs: Tensor) -> Any:  # noqa: ANN401 - of `output_type`
        """Run the network."""
        ...

    def inputs(self, sweeps: Sequence[Sweep]) -> dict[str, Tensor]:
        """Make the module's inputs for sweeps with at least one point each."""
        ...

    def propose(
        self,
        output: Any,  # noqa: ANN401 - of `output_type`
        sweeps: Sequence[Sweep],
        *,
        training: bool,
    ) -> tuple[Proposed, ...]:
        """Compute each sweep's proposals, for inference or second-stage training; no gradient."""
        ...

    def losses(
        self,
        output: Any,  # noqa: ANN401 - of `output_type`
        sweeps: Sequence[Sweep],
        truths: Sequence[SweepTruth],
        config: Detection3DLossConfig,
    ) -> Losses:
        """Compute the training losses."""
        ...


class Regions(NamedTuple):
    """Proposals with the points around them: input of a second stage."""

    places: Int64[Tensor, " num_rois"]
    """Indices into all proposals."""
    boxes: Float[Tensor, "num_rois 7"]
    """Boxes of the proposals."""
    scores: Float[Tensor, " num_rois"]
    """Scores of the proposals."""
    inputs: dict[str, Tensor]
    """Inputs of the module; their first axis counts the regions."""


class Refined(NamedTuple):
    """Refined boxes of regions."""

    boxes: Float[Tensor, "num_rois 7"]
    """x, y, z, length, width, height, yaw (frame of the sweep, metres, radians)."""
    scores: Float[Tensor, " num_rois"]
    """Confidence, 0 to 1."""
    front_logits: Float[Tensor, " num_rois"]
    """Log-odds that the front is at the box's front end; 0 if the design does not predict it."""


@runtime_checkable
class SecondStage(Protocol):
    """Interface of a second stage: proposals to refined boxes; an `nn.Module`."""

    @property
    def passes(self) -> int:
        """Number of passes, each from the output of the one before."""
        ...

    @property
    def mean_with_first(self) -> tuple[str, ...]:
        """Classes whose result is the mean of the first and last pass, not the last."""
        ...

    @property
    def output_type(self) -> Callable[..., tuple[Any, ...]]:
        """Type of the module's output."""
        ...

    @property
    def views(self) -> tuple[View, ...]:
        """Views of the flip test; the first is the unchanged region."""
        ...

    def __call__(self, **inputs: Tensor) -> Any:  # noqa: ANN401 - of `output_type`
        """Run the network."""
        ...

    def regions(
        self,
        sweep: Sweep,
        proposed: Proposed,
        *,
        seed: int,
    ) -> Regions:
        """Collect the points around proposals; useless proposals may be dropped."""
        ...

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
        ...

    def refine(
        self,
        output: Any,  # noqa: ANN401 - of `output_type`
        regions: Regions,
    ) -> Refined:
        """Decode the module's boxes for regions, with their scores."""
        ...

    def losses(
        self,
        output: Any,  # noqa: ANN401 - of `output_type`
        regions: Regions,
        wanted: Any,  # noqa: ANN401 - as `examples` gives it
        config: Detection3DLossConfig,
    ) -> Losses:
        """Compute the training losses."""
        ...

"""What the stages of detectors have in common, whatever their design.

A stage's module is what leaves PyTorch: tensors in by name, a NamedTuple out. Searches, draws and
suppression, which other engines do not know, come before it (`inputs`) and after it.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import torch
from jaxtyping import Float, Float32, Int64
from torch import Tensor

from sightline.detection3d.loss_config import Detection3DLossConfig
from sightline.detection3d.targets import SweepTruth
from sightline.detection3d.views import View
from sightline.training.module import Losses

Sweep = Float32[Tensor, "_ 4"]
"""LiDAR frame, raised by the settings' height offset: x, y, z [m], reflectance."""


def full_precision(near: Tensor) -> torch.autocast:
    """Switches automatic mixed precision off on a tensor's device: it is for networks alone.

    Boxes are turned by matrix products, which it would round to bfloat16: decimetres at 60 m.
    """
    return torch.autocast(near.device.type, enabled=False)


class Proposed(NamedTuple):
    """What a first stage makes of a sweep."""

    boxes: Float[Tensor, "num_proposals 7"]
    """x, y, z, length, width, height, yaw (frame of the sweep, metres, radians)."""
    classes: Int64[Tensor, " num_proposals"]
    """Places among the detector's classes."""
    scores: Float[Tensor, " num_proposals"]
    """Confidence, 0 to 1."""
    features: Float[Tensor, "num_points channels"] | None = None
    """Of the sweep's points; None of a design that gives none."""


@runtime_checkable  # for beartype, which checks arguments under pytest
class FirstStage(Protocol):
    """From sweeps to proposals; an `nn.Module`."""

    @property
    def feature_channels(self) -> int:
        """What it gives for each point besides proposals; 0: nothing."""
        ...

    @property
    def max_proposals(self) -> int:
        """Of a sweep, in use."""
        ...

    @property
    def output_type(self) -> Callable[..., tuple[Any, ...]]:
        """What the module gives."""
        ...

    @property
    def views(self) -> tuple[View, ...]:
        """What a flip test asks the module about; the first is the scene as it is."""
        ...

    def __call__(self, **inputs: Tensor) -> Any:  # noqa: ANN401 - of `output_type`
        """The network."""
        ...

    def inputs(self, sweeps: Sequence[Sweep]) -> dict[str, Tensor]:
        """What the module takes for sweeps of a point each at least."""
        ...

    def propose(
        self,
        output: Any,  # noqa: ANN401 - of `output_type`
        sweeps: Sequence[Sweep],
        *,
        training: bool,
    ) -> tuple[Proposed, ...]:
        """The proposals of each sweep, in use or for a second stage's training; no gradient."""
        ...

    def losses(
        self,
        output: Any,  # noqa: ANN401 - of `output_type`
        sweeps: Sequence[Sweep],
        truths: Sequence[SweepTruth],
        config: Detection3DLossConfig,
    ) -> Losses:
        """What the module is trained to lower."""
        ...


class Regions(NamedTuple):
    """The proposals with points around them, as a second stage takes them."""

    places: Int64[Tensor, " num_rois"]
    """Among all proposals."""
    boxes: Float[Tensor, "num_rois 7"]
    """As proposed."""
    scores: Float[Tensor, " num_rois"]
    """Of the proposals."""
    inputs: dict[str, Tensor]
    """What the module takes; the first axis of each counts the regions."""


class Refined(NamedTuple):
    """Boxes of regions."""

    boxes: Float[Tensor, "num_rois 7"]
    """x, y, z, length, width, height, yaw (frame of the sweep, metres, radians)."""
    scores: Float[Tensor, " num_rois"]
    """Confidence, 0 to 1."""
    front_logits: Float[Tensor, " num_rois"]
    """How sure it is that the front is where the box has it: log-odds, 0 where it does not tell."""


@runtime_checkable
class SecondStage(Protocol):
    """From proposals to better boxes; an `nn.Module`."""

    @property
    def passes(self) -> int:
        """How often it is applied, each time to what it gave before."""
        ...

    @property
    def mean_with_first(self) -> tuple[str, ...]:
        """Classes of which the mean of the first pass and the last is answered, not the last."""
        ...

    @property
    def output_type(self) -> Callable[..., tuple[Any, ...]]:
        """What the module gives."""
        ...

    @property
    def views(self) -> tuple[View, ...]:
        """What a flip test asks the module about; the first is each region as it is."""
        ...

    def __call__(self, **inputs: Tensor) -> Any:  # noqa: ANN401 - of `output_type`
        """The network."""
        ...

    def regions(
        self,
        sweep: Sweep,
        proposed: Proposed,
        *,
        seed: int,
    ) -> Regions:
        """Gathers what is around proposals; those that tell nothing may be left out."""
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
        """Draws regions of a sweep to train on, with what they are to become.

        The latter is a NamedTuple of the stage's own; the first axis of each tensor counts the
        regions.
        """
        ...

    def refine(
        self,
        output: Any,  # noqa: ANN401 - of `output_type`
        regions: Regions,
    ) -> Refined:
        """The boxes that the module gave for regions, with their scores."""
        ...

    def losses(
        self,
        output: Any,  # noqa: ANN401 - of `output_type`
        regions: Regions,
        wanted: Any,  # noqa: ANN401 - as `examples` gives it
        config: Detection3DLossConfig,
    ) -> Losses:
        """What the module is trained to lower."""
        ...

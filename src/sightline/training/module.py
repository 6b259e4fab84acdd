"""What every task's training has in common: a network, its optimiser, what a checkpoint tells."""

import json
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, ClassVar, Literal, Protocol, runtime_checkable

import lightning
from lightning.pytorch.utilities.types import OptimizerLRScheduler
from torch import nn
from torch.optim import Adam, AdamW, Optimizer
from torch.optim.lr_scheduler import LambdaLR, LRScheduler, OneCycleLR

from sightline.training.checkpoint import CHECKPOINT_KEY, read_weights

_FEWEST_STEPS = 4  # of a one-cycle schedule: two of warm-up, two of cooling down


@dataclass(frozen=True, kw_only=True)
class OptimizerConfig:
    """How the weights are updated. Clipping is the Trainer's: `trainer.gradient_clip_val`."""

    name: Literal["adam", "adamw"] = "adamw"
    """adam: Kingma and Ba 2015 (arXiv:1412.6980); adamw: Loshchilov and Hutter 2019
    (arXiv:1711.05101)."""
    learning_rate: float = 1e-3
    """The highest that the schedule reaches."""
    weight_decay: float = 0.0
    """Of all weights; adam adds it to the gradient, adamw takes it off the weights."""
    schedule: Literal["constant", "one_cycle", "cosine"] = "constant"
    """How the learning rate goes after the warm-up: stays, or falls to nothing by the last step.
    one_cycle (Smith and Topin 2018, arXiv:1708.07120) also moves Adam's first momentum."""
    warm_up_share: float = 0.0
    """Share of all steps during which the learning rate rises."""

    def __post_init__(self) -> None:
        """Checks the ranges."""
        if self.learning_rate <= 0:
            raise ValueError(f"learning_rate must be positive, got {self.learning_rate}")
        if self.weight_decay < 0:
            raise ValueError(f"weight_decay must not be negative, got {self.weight_decay}")
        if not 0 <= self.warm_up_share < 1:
            raise ValueError(f"warm_up_share must be in [0, 1), got {self.warm_up_share}")


@runtime_checkable  # for beartype, which checks arguments under pytest
class NetworkConfig(Protocol):
    """A dataclass: every field has a default, and holds what JSON can hold, or tuples."""

    __dataclass_fields__: ClassVar[dict[str, Any]]


class TrainingModule(lightning.LightningModule, ABC):
    """A network in training; a task adds its loss and its metrics.

    A task sets the class variables and writes `network_config`, `training_step` and, where it has
    them, `validation_step` and `test_step`. Nothing but plain values and tensors goes into a
    checkpoint, so that it is read without running code from it.
    """

    task_name: ClassVar[str]
    """Stands in checkpoints and weights files."""
    monitored: ClassVar[tuple[str, Literal["min", "max"]]]
    """The metric of a validation that decides which weights are best, and which way is better."""

    def __init__(
        self, network: nn.Module, *, optimizer: OptimizerConfig, initial_weights: Path | None = None
    ) -> None:
        """Takes the network.

        Args:
            network: What is trained.
            optimizer: How.
            initial_weights: Such a network's weights to start from: name of shipped ones, file or
                checkpoint.

        Raises:
            ValueError: The initial weights cannot be read or are another network's.
        """
        super().__init__()
        self.network = network
        self.optimizer = optimizer
        if initial_weights is not None:
            weights = read_weights(initial_weights)
            self._check_same_network(str(initial_weights), weights.task, weights.config)
            self.network.load_state_dict(weights.tensors)

    @abstractmethod
    def network_config(self) -> NetworkConfig:
        """The settings that build the network again."""

    def configure_optimizers(self) -> OptimizerLRScheduler:
        """Makes the optimiser and, over all steps of the training, its schedule."""
        kind = Adam if self.optimizer.name == "adam" else AdamW
        optimizer = kind(
            [parameter for parameter in self.parameters() if parameter.requires_grad],
            lr=self.optimizer.learning_rate,
            weight_decay=self.optimizer.weight_decay,
        )
        if self.optimizer.schedule == "constant" and self.optimizer.warm_up_share == 0:
            return optimizer
        total_steps = self.trainer.estimated_stepping_batches
        if math.isinf(total_steps):
            raise ValueError(
                "a schedule of the learning rate needs to know the number of steps; set "
                "trainer.max_epochs or trainer.max_steps, or take optimizer.schedule: constant "
                "and no warm-up"
            )
        scheduler = make_schedule(optimizer, self.optimizer, int(total_steps))
        return {
            "optimizer": optimizer,
            "lr_scheduler": {"scheduler": scheduler, "interval": "step"},
        }

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Describes the network in the checkpoint."""
        data = getattr(self.trainer, "datamodule", None)
        checkpoint[CHECKPOINT_KEY] = {
            "task": self.task_name,
            "config": _plain(self.network_config()),
            "provenance": {
                "sightline": version("sightline"),
                "seed": str(getattr(data, "seed", "unknown")),
                "steps": str(self.trainer.global_step),
                "epochs": str(self.trainer.current_epoch),
            },
        }

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Refuses a checkpoint of another network."""
        description = checkpoint.get(CHECKPOINT_KEY)
        if description is None:
            raise ValueError(
                "the checkpoint is none of sightline; name one that sightline fit wrote"
            )
        self._check_same_network("the checkpoint", description["task"], description["config"])

    def _check_same_network(self, source: str, task: str, config: Mapping[str, object]) -> None:
        if task != self.task_name:
            raise ValueError(
                f"{source} is of task {task}, expected {self.task_name}; name another or change "
                "the recipe"
            )
        settings = self.network_config()
        ours, theirs = _plain(settings), _completed(config, _plain(type(settings)()))
        differing = sorted(
            name for name in ours.keys() | theirs.keys() if ours.get(name) != theirs.get(name)
        )
        if differing:
            described = ", ".join(
                f"{name} {theirs.get(name)} instead of {ours.get(name)}" for name in differing
            )
            raise ValueError(
                f"{source} holds a network of other settings ({described}); take the recipe that "
                "it was trained with"
            )


def _plain(settings: NetworkConfig) -> dict[str, object]:
    plain: dict[str, object] = json.loads(json.dumps(asdict(settings)))
    return plain


def _completed(config: Mapping[str, object], defaults: Mapping[str, object]) -> dict[str, object]:
    """Settings from a file, with the defaults of those that it is too old to name."""
    completed = dict(defaults)
    for name, value in config.items():
        default = defaults.get(name)
        if isinstance(value, Mapping) and isinstance(default, Mapping):
            completed[name] = _completed(value, default)
        else:
            completed[name] = value
    return completed


def make_schedule(optimizer: Optimizer, config: OptimizerConfig, total_steps: int) -> LRScheduler:
    """The learning rate over `total_steps` updates; stepped after each.

    Args:
        optimizer: Its learning rate is set.
        config: Which schedule.
        total_steps: Length of the training; a one-cycle schedule takes four at least.
    """
    warm_up_steps = round(config.warm_up_share * total_steps)
    if config.schedule == "one_cycle":
        total_steps = max(total_steps, _FEWEST_STEPS)
        # PyTorch divides by the length of each phase, less one.
        warm_up_steps = min(max(warm_up_steps, 2), total_steps - 2)
        return OneCycleLR(
            optimizer,
            max_lr=config.learning_rate,
            total_steps=total_steps,
            pct_start=warm_up_steps / total_steps,
        )

    def factor(step: int) -> float:
        if step < warm_up_steps:
            return (step + 1) / (warm_up_steps + 1)
        if config.schedule == "constant":
            return 1.0
        progress = (step - warm_up_steps) / max(total_steps - warm_up_steps, 1)
        return (1 + math.cos(math.pi * min(progress, 1.0))) / 2

    return LambdaLR(optimizer, factor)

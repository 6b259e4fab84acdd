"""What every task's training has in common: network, optimiser, steps, scores, checkpoints."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, ClassVar, Literal, Protocol, runtime_checkable

import lightning
import numpy as np
import torch
from jaxtyping import UInt8
from lightning.pytorch.loggers import TensorBoardLogger
from lightning.pytorch.utilities.types import OptimizerLRScheduler
from torch import Tensor, nn
from torch.optim import SGD, Adam, AdamW, Optimizer
from torch.optim.lr_scheduler import LambdaLR, LRScheduler, OneCycleLR
from torchmetrics import Metric

from sightline.data.settings import (
    ConfigT,
    NetworkConfig,
    differing_settings,
    parse_settings,
    plain_settings,
)
from sightline.data.weights import CHECKPOINT_KEY, fill_network, read_weights
from sightline.structures.batch import Batch

_NUM_STEPS_KEY = "sightline_num_steps"
_FEWEST_STEPS = 4  # of a one-cycle schedule: two of warm-up, two of cooling down
_NUM_PICTURES = 4  # validation batches of which the first sample is drawn


@dataclass(frozen=True, kw_only=True)
class OptimizerConfig:
    """How the weights are updated. Clipping is the Trainer's: `trainer.gradient_clip_val`."""

    name: Literal["adam", "adamw", "sgd"] = "adamw"
    """adam: Kingma and Ba 2015 (arXiv:1412.6980); adamw: Loshchilov and Hutter 2019
    (arXiv:1711.05101); sgd: gradient descent with momentum."""
    learning_rate: float = 1e-3
    """The highest rate of the schedule."""
    weight_decay: float = 0.0
    """Of all weights; adam and sgd add it to the gradient, adamw takes it off the weights."""
    momentum: float = 0.9
    """Of sgd."""
    schedule: Literal["constant", "one_cycle", "cosine", "steps"] = "constant"
    """The learning rate after the warm-up: stays, falls to 0 by the last step, or is multiplied by
    `drop_factor` at each of `drop_shares`. one_cycle (Smith and Topin 2018, arXiv:1708.07120) also
    moves the (first) momentum."""
    warm_up_share: float = 0.0
    """Share of all steps during which the learning rate rises."""
    drop_shares: tuple[float, ...] = ()
    """Shares of all steps after which schedule steps lowers the rate, in their order."""
    drop_factor: float = 0.1
    """Factor by which the schedule steps multiplies the learning rate."""

    def __post_init__(self) -> None:
        """Checks the ranges."""
        if self.learning_rate <= 0:
            raise ValueError(f"learning_rate must be positive, got {self.learning_rate}")
        if self.weight_decay < 0:
            raise ValueError(f"weight_decay must not be negative, got {self.weight_decay}")
        if not 0 <= self.warm_up_share < 1:
            raise ValueError(f"warm_up_share must be in [0, 1), got {self.warm_up_share}")
        if not 0 <= self.momentum < 1:
            raise ValueError(f"momentum must be in [0, 1), got {self.momentum}")
        if not 0 < self.drop_factor <= 1:
            raise ValueError(f"drop_factor must be in (0, 1], got {self.drop_factor}")
        ends = (self.warm_up_share, *self.drop_shares, 1)
        if list(ends) != sorted(ends):
            raise ValueError(
                f"drop_shares must rise from warm_up_share {self.warm_up_share} to 1 at most, got "
                f"{self.drop_shares}"
            )
        if bool(self.drop_shares) != (self.schedule == "steps"):
            raise ValueError(
                f"drop_shares belong to schedule steps, got schedule {self.schedule} and "
                f"drop_shares {self.drop_shares}; set both or neither"
            )


@runtime_checkable  # for beartype, which checks arguments under pytest
class Losses(Protocol):
    """A NamedTuple of scalars: the training loss and its terms."""

    @property
    def total(self) -> Tensor:
        """The training loss."""

    def _asdict(self) -> dict[str, Any]: ...


class TrainingModule(lightning.LightningModule, ABC):
    """A network in training; a task says what its losses, scores and pictures are.

    A task sets the class variables and writes `network_config`, `losses`, `score` and, where there
    is something to see, `picture`. Nothing but plain values and tensors goes into a checkpoint, so
    that it is read without running code from it.
    """

    task_name: ClassVar[str]
    """The task's name in checkpoints and weights files."""
    monitored: ClassVar[tuple[str, Literal["min", "max"]]]
    """The score of a validation that decides which weights are best, such as validation/rmse_mm,
    and which way is better."""

    def __init__(
        self,
        network: nn.Module,
        metric: Metric,
        *,
        optimizer: OptimizerConfig,
        initial_weights: Path | None = None,
        initial_part: str | None = None,
    ) -> None:
        """Takes the network.

        Args:
            network: What is trained.
            metric: What `score` updates; it computes scores by name.
            optimizer: How.
            initial_weights: Weights to start from: name of shipped ones, file or checkpoint.
            initial_part: The part of the network that the weights fill, a first stage for one: the
                name of a module of the network and of the setting that it is built by. None: all.

        Raises:
            ValueError: The initial weights cannot be read or are another network's.
        """
        super().__init__()
        # Convolutions on a CPU, and with halved precision on a GPU, are up to twice as fast so.
        self.network = network.to(memory_format=torch.channels_last)
        self.metric = metric
        self.optimizer = optimizer
        self._num_steps: int | None = None  # that the schedule is made for
        if initial_weights is not None:
            self._start_from(initial_weights, initial_part)
        elif initial_part is not None:
            raise ValueError(
                f"initial_part {initial_part} says what initial_weights fill: set those too"
            )

    @abstractmethod
    def network_config(self) -> NetworkConfig:
        """The settings that build the network again."""

    @abstractmethod
    def losses(self, batch: Any) -> Losses:  # noqa: ANN401 - the task's own batch
        """The loss of a batch and its terms."""

    @abstractmethod
    def score(self, batch: Any) -> Any:  # noqa: ANN401 - the task's own batch and answer
        """Updates `metric` by a batch; gives what the network answered."""

    def scores(self) -> Mapping[str, Tensor]:
        """All scores to log, by name, once every batch has been scored."""
        scores: Mapping[str, Tensor] = self.metric.compute()
        return scores

    def picture(
        self,
        batch: Any,  # noqa: ANN401 - the task's own batch
        answer: Any,  # noqa: ANN401 - what `score` gave
    ) -> UInt8[np.ndarray, "height width 3"] | None:
        """The first sample of a batch and what the network made of it; None: nothing to see."""
        del batch, answer
        return None

    def training_step(self, batch: Batch, batch_idx: int) -> Tensor:
        """The loss of a batch; logs it and its terms."""
        del batch_idx
        losses = self.losses(batch)
        terms = {f"training/{name}": value for name, value in losses._asdict().items()}
        self.log_dict(terms, batch_size=len(batch))
        self.log("loss", losses.total, prog_bar=True, logger=False, batch_size=len(batch))
        return losses.total

    def validation_step(self, batch: Batch | None, batch_idx: int) -> None:
        """Scores a batch, and draws the first few. None: only other ranks have samples left."""
        if batch is None:
            return
        answer = self.score(batch)
        if batch_idx < _NUM_PICTURES and isinstance(self.logger, TensorBoardLogger):
            picture = self.picture(batch, answer)
            if picture is not None:
                self.logger.experiment.add_image(
                    f"validation/{batch_idx}", picture, self.global_step, dataformats="HWC"
                )

    def on_validation_epoch_end(self) -> None:
        """Logs the scores."""
        self._log_scores("validation")

    def test_step(self, batch: Batch | None, batch_idx: int) -> None:
        """Scores a batch. None: only other ranks have samples left."""
        del batch_idx
        if batch is not None:
            self.score(batch)

    def on_test_epoch_end(self) -> None:
        """Logs the scores."""
        self._log_scores("test")

    def configure_optimizers(self) -> OptimizerLRScheduler:
        """Makes the optimiser and, over all steps of the training, its schedule."""
        optimizer = make_optimizer(
            [parameter for parameter in self.parameters() if parameter.requires_grad],
            self.optimizer,
        )
        if self.optimizer.schedule == "constant" and self.optimizer.warm_up_share == 0:
            self._num_steps = None
            return optimizer
        total_steps = self.trainer.estimated_stepping_batches
        if math.isinf(total_steps):
            raise ValueError(
                "a schedule of the learning rate needs to know the number of steps; set "
                "trainer.max_epochs or trainer.max_steps, or take optimizer.schedule: constant "
                "and no warm-up"
            )
        if self._num_steps not in (None, total_steps):
            raise ValueError(
                f"the run was begun for {self._num_steps} steps, by which its learning rate goes, "
                f"but now it would have {total_steps}; resume with the trainer.max_steps, "
                "max_epochs and data that it was begun with, or begin another run from its weights "
                "by model.init_args.initial_weights"
            )
        self._num_steps = int(total_steps)
        scheduler = make_schedule(optimizer, self.optimizer, self._num_steps)
        return {
            "optimizer": optimizer,
            "lr_scheduler": {"scheduler": scheduler, "interval": "step"},
        }

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Describes the network in the checkpoint."""
        data = getattr(self.trainer, "datamodule", None)
        checkpoint[_NUM_STEPS_KEY] = self._num_steps
        checkpoint[CHECKPOINT_KEY] = {
            "task": self.task_name,
            "config": plain_settings(self.network_config()),
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
        self._check_task("the checkpoint", description["task"])
        _check_settings("the checkpoint", description["config"], self.network_config())
        self._num_steps = checkpoint.get(_NUM_STEPS_KEY)

    def _log_scores(self, stage: str) -> None:
        # float32: not every accelerator has more
        scores = {f"{stage}/{name}": score.float() for name, score in self.scores().items()}
        with torch.inference_mode(mode=False):  # else training could not go on with its tensors
            self.metric.reset()
        shown, _ = self.monitored
        for name, score in scores.items():
            self.log(name, score, prog_bar=name == shown)

    def _start_from(self, source: Path, part: str | None) -> None:
        weights = read_weights(source)
        name = str(source)
        if part is None:
            self._check_task(name, weights.task)
            _check_settings(name, weights.config, self.network_config())
            _load(self.network, weights.tensors, name)
            return
        parts = dict(self.network.named_children())
        settings = getattr(self.network_config(), part, None)
        if part not in parts or not isinstance(settings, NetworkConfig):
            raise ValueError(
                f"initial_part {part} is no part of the network that has settings of its own; its "
                f"modules are {', '.join(parts)}"
            )
        given, tensors = weights.config, weights.tensors
        if weights.task == self.task_name:  # such a network as a whole, of which the part is wanted
            of_part = given.get(part)
            given = of_part if isinstance(of_part, dict) else {}
            tensors = {
                key.removeprefix(f"{part}."): tensor
                for key, tensor in tensors.items()
                if key.startswith(f"{part}.")
            }
        _check_settings(name, given, settings)
        _load(parts[part], tensors, name)

    def _check_task(self, source: str, task: str) -> None:
        if task != self.task_name:
            raise ValueError(
                f"{source} is of task {task}, expected {self.task_name}; name another or change "
                "the recipe"
            )


def choose_settings(given: ConfigT | None, kind: type[ConfigT], weights: Path | None) -> ConfigT:
    """A network's settings: those given, else those of the weights that it starts from.

    Args:
        given: As the recipe has them; None where it leaves them to the weights.
        kind: What settings the network takes.
        weights: Name or file; None: none, and the settings are the defaults.

    Raises:
        ValueError: The weights cannot be read or are another network's.
    """
    if given is not None:
        return given
    if weights is None:
        return kind()
    plain = read_weights(weights).config
    try:
        return parse_settings(kind, plain)
    except ValueError as error:
        raise ValueError(
            f"{weights} describes a network that cannot be built here ({error}); name others"
        ) from error


def _check_settings(source: str, given: Mapping[str, object], ours: NetworkConfig) -> None:
    differing = differing_settings(given, ours)
    if differing:
        raise ValueError(
            f"{source} holds a network of other settings ({differing}); take the recipe that it "
            "was trained with"
        )


def _load(module: nn.Module, tensors: Mapping[str, Tensor], source: str) -> None:
    try:
        fill_network(module, tensors)
    except ValueError as error:
        raise ValueError(
            f"{source} does not fit the network that it describes ({error}); name another"
        ) from error


def make_optimizer(parameters: Sequence[nn.Parameter], config: OptimizerConfig) -> Optimizer:
    """What updates the parameters."""
    rate, decay = config.learning_rate, config.weight_decay
    if config.name == "sgd":
        return SGD(parameters, lr=rate, momentum=config.momentum, weight_decay=decay)
    kind = Adam if config.name == "adam" else AdamW
    return kind(parameters, lr=rate, weight_decay=decay)


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
        if config.schedule == "steps":
            drops = (round(share * total_steps) for share in config.drop_shares)
            return config.drop_factor ** sum(step >= drop for drop in drops)
        progress = (step - warm_up_steps) / max(total_steps - warm_up_steps, 1)
        return (1 + math.cos(math.pi * min(progress, 1.0))) / 2

    return LambdaLR(optimizer, factor)

"""Base class of every task's training: network, steps, scores, checkpoints."""

import math
import sys
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any, ClassVar, Final, Literal

import lightning
import numpy as np
import torch
from jaxtyping import UInt8
from lightning.pytorch.loggers import TensorBoardLogger
from lightning.pytorch.trainer.states import TrainerFn
from lightning.pytorch.utilities import rank_zero_only
from lightning.pytorch.utilities.types import OptimizerLRScheduler
from torch import Tensor, nn
from torchmetrics import Metric

from sightline.data.formats.image_file import write_rgb
from sightline.files.settings import NetworkConfig, config_to_dict
from sightline.files.weights import CHECKPOINT_KEY, Weights
from sightline.geometry.arguments import check_collection
from sightline.structures.batch import Batch, FieldwiseBatch, Losses
from sightline.training.initial_weights import check_network, check_shapes, load_initial_weights
from sightline.training.optimizer import (
    OptimizerConfig,
    freeze,
    hold_frozen_norms,
    make_optimizer,
    make_schedule,
    unmatched_rate_factors,
)
from sightline.training.own_code import listed_samples, naming_samples
from sightline.visualization.lettering import with_title

STEP: Final = "step"
"""Lightning's name of the training step among the scores of a checkpoint."""

_NUM_STEPS_KEY = "sightline_num_steps"
_TRAINING_STATE: Final = {
    "epoch": int,
    "global_step": int,
    "loops": dict,
    "callbacks": dict,
    "optimizer_states": list,
    "lr_schedulers": list,
}
"""Parts of a checkpoint that a resumed training needs, and their types."""
_FINITE_CHECK_INTERVAL = 50  # interval of checks for a finite loss on a GPU
_NUM_PICTURES = 4  # number of validation batches whose first sample is drawn


class TrainingModule(lightning.LightningModule, ABC):
    """Network in training; a task defines its losses, scores and pictures.

    A task sets the class variables and implements `network_config`, `losses`, `score` and
    optionally `picture`. Checkpoints contain only plain values and tensors, so that reading one
    runs no code from it.
    """

    task_name: ClassVar[str]
    """The task's name in checkpoints and weights files."""
    monitored: ClassVar[tuple[str, Literal["min", "max"]]]
    """Validation score that selects the best weights, such as validation/rmse_mm, and its
    direction."""
    monitored_beside: ClassVar[tuple[str, ...]] = ()
    """Further scores shown beside the monitored one."""
    notes: tuple[str, ...] = ()
    """Notes on the scores of the last validation or test."""
    is_resumed: bool = False
    """Set before a fit that resumes from a checkpoint, which replaces the weights; Lightning loads
    it after `setup`."""
    resumed_step: int = 0
    """Number of steps of the checkpoint that a fit resumed from."""

    def __init__(
        self,
        network: nn.Module,
        metric: Metric,
        *,
        optimizer: OptimizerConfig,
        initial_weights: Path | None = None,
        initial_part: str | None = None,
    ) -> None:
        """Store the network.

        Args:
            network: Network to train.
            metric: Metric that `score` updates; it computes scores by name.
            optimizer: Settings of the optimiser.
            initial_weights: Weights to start from: name of shipped ones, file or checkpoint.
            initial_part: Part of the network to load the weights into, such as a first stage: the
                name of a module of the network and of the setting that builds it. None: all.

        Raises:
            ValueError: The initial weights cannot be read or belong to another network.
        """
        super().__init__()
        check_collection(f"{type(self).__name__}.monitored_beside", self.monitored_beside)
        # Makes convolutions up to twice as fast, on a CPU and with half precision on a GPU.
        self.network = network.to(memory_format=torch.channels_last)
        self.metric = metric
        self.optimizer = optimizer
        self._num_steps: int | None = None  # length of the schedule
        self._scored_at: tuple[int, int] | None = None  # epoch and step of a scored checkpoint
        if initial_weights is not None:
            load_initial_weights(
                initial_weights,
                self.network,
                self.network_config(),
                task_name=self.task_name,
                part=initial_part,
            )
        elif initial_part is not None:
            raise ValueError(f"initial_part {initial_part} needs initial_weights; set both")
        freeze(self, optimizer)

    @abstractmethod
    def network_config(self) -> NetworkConfig:
        """Settings for rebuilding the network."""

    def train(self, mode: bool = True) -> "TrainingModule":  # noqa: FBT001 - as PyTorch's
        """Set the mode; frozen batch normalisations stay in evaluation mode."""
        super().train(mode)
        hold_frozen_norms(self)
        return self

    def final_weights(self, weights: Weights) -> Weights:
        """Convert weights of a checkpoint for use: by default they stay as they are."""
        return weights

    def load_start(self) -> None:
        """Load what a training starts from over the initial weights; by default nothing.

        Called before these weights are scored at step 0; a second call must change nothing. A
        resumed training has them in its checkpoint.

        Raises:
            ValueError: Weights cannot be loaded.
        """

    @abstractmethod
    def losses(self, batch: Any) -> Losses:  # noqa: ANN401 - the task's own batch
        """Compute the loss of a batch and its terms."""

    @abstractmethod
    def score(self, batch: Any) -> Any:  # noqa: ANN401 - the task's own batch and prediction
        """Update `metric` with a batch; return the network's prediction."""

    def scores(self) -> Mapping[str, Tensor]:
        """All scores to log, by name, after every batch has been scored."""
        scores: Mapping[str, Tensor] = self.metric.compute()
        return scores

    def score_notes(self) -> tuple[str, ...]:
        """Notes on the last scores of `scores`, as sentences."""
        return ()

    def difference_in_use(self) -> str | None:
        """Describe how predictors may work otherwise than `score`, as a sentence; None: not."""
        return None

    def picture(
        self,
        batch: Any,  # noqa: ANN401 - the task's own batch
        prediction: Any,  # noqa: ANN401 - the result of `score`
    ) -> UInt8[np.ndarray, "height width 3"] | None:
        """Draw the first sample of a batch and its prediction; None: no picture."""
        del batch, prediction
        return None

    def training_step(self, batch: Batch, batch_idx: int) -> Tensor:
        """Compute and log the loss of a batch and its terms.

        Raises:
            ValueError: The loss is not finite: by the batch, the task's losses, or a divergence.
        """
        del batch_idx
        with self._explaining_failures(batch):
            losses = self.losses(batch)
        self._check_finite(losses.total, batch)
        terms = {f"training/{name}": value for name, value in losses._asdict().items()}
        self.log_dict(terms, batch_size=len(batch))
        self.log("loss", losses.total, prog_bar=True, logger=False, batch_size=len(batch))
        return losses.total

    def validation_step(self, batch: Batch | None, batch_idx: int) -> None:
        """Score a batch; draw the first few. Batch None: only other ranks have samples left."""
        if batch is None:
            return
        with self._explaining_failures(batch):
            prediction = self.score(batch)
            is_drawn = batch_idx < _NUM_PICTURES and self.loggers
            picture = self.picture(batch, prediction) if is_drawn else None
        if picture is not None:
            epoch, step = self._scored_at or (self.current_epoch, self.global_step)
            title = f"{batch.sample_ids[0]}: epoch {epoch}, after {step:,} steps"
            _log_picture(self.loggers, f"validation/{batch_idx}", with_title(picture, title), step)

    def on_validation_epoch_end(self) -> None:
        """Log the scores."""
        self._log_scores("validation")

    def test_step(self, batch: Batch | None, batch_idx: int) -> None:
        """Score a batch. Batch None: only other ranks have samples left."""
        del batch_idx
        if batch is not None:
            with self._explaining_failures(batch):
                self.score(batch)

    def on_test_epoch_end(self) -> None:
        """Log the scores."""
        self._log_scores("test")

    def configure_optimizers(self) -> OptimizerLRScheduler:
        """Create the optimiser and its schedule over all steps of the training."""
        named = dict(self.named_parameters())
        trained = {name: each for name, each in named.items() if each.requires_grad}
        optimizer = make_optimizer(trained.items(), self.optimizer)
        for pattern in unmatched_rate_factors(named.keys(), self.optimizer):
            rank_zero_only(print)(
                f"optimizer.rate_factors has {pattern}, which matches no parameter of the network",
                file=sys.stderr,
            )
        if self.optimizer.schedule == "constant" and self.optimizer.warm_up_share == 0:
            self._num_steps = None
            return optimizer
        total_steps = self.trainer.estimated_stepping_batches
        if math.isinf(total_steps):
            raise ValueError(
                "a schedule of the learning rate needs the number of steps; set "
                "--trainer.max_epochs or --trainer.max_steps, or "
                "--model.init_args.optimizer.schedule constant without a warm-up"
            )
        if self._num_steps not in (None, total_steps):
            raise ValueError(
                f"the run's learning rate schedule has {self._num_steps} steps, but the run now "
                f"has {total_steps}; resume with its original --trainer.max_steps, "
                "--trainer.max_epochs and data, or start another run from its weights by "
                "--model.init_args.initial_weights"
            )
        self._num_steps = int(total_steps)
        scheduler = make_schedule(optimizer, self.optimizer, self._num_steps)
        return {
            "optimizer": optimizer,
            "lr_scheduler": {"scheduler": scheduler, "interval": "step"},
        }

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Describe the network in the checkpoint."""
        data = getattr(self.trainer, "datamodule", None)
        checkpoint[_NUM_STEPS_KEY] = self._num_steps
        checkpoint[CHECKPOINT_KEY] = {
            "task": self.task_name,
            "config": config_to_dict(self.network_config()),
            "provenance": {
                "sightline": version("sightline"),
                "seed": str(getattr(data, "seed", "unknown")),
                "steps": str(self.trainer.global_step),
                "epochs": str(_num_epochs(self.trainer)),
            },
        }

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Refuse a checkpoint of another network; take its step if it is only scored."""
        description = checkpoint.get(CHECKPOINT_KEY)
        if description is None:
            raise ValueError(
                "the checkpoint was not written by sightline; name one of sightline fit"
            )
        check_network(
            "the checkpoint",
            description["task"],
            description["config"],
            task_name=self.task_name,
            config=self.network_config(),
        )
        check_shapes(checkpoint["state_dict"], self.state_dict())
        self._num_steps = checkpoint.get(_NUM_STEPS_KEY)
        if self._trainer is None:
            return
        if self._trainer.state.fn is TrainerFn.FITTING:
            _check_resumable(checkpoint)
            self.resumed_step = checkpoint["global_step"]
        else:
            self._scored_at = (int(checkpoint["epoch"]), int(checkpoint["global_step"]))

    @contextmanager
    def _explaining_failures(self, batch: Batch) -> Iterator[None]:
        """Report a divergence if a batch fails because the weights are not finite, else name it."""
        try:
            with naming_samples(lambda: batch.sample_ids):
                yield
        except ValueError as error:
            if not self._has_finite_weights():
                raise self._diverged("its weights are not finite") from error
            raise

    def _has_finite_weights(self) -> bool:
        return all(bool(parameter.isfinite().all()) for parameter in self.parameters())

    def _check_finite(self, loss: Tensor, batch: Batch) -> None:
        """End a training whose loss is not finite."""
        trainer = self._trainer
        if trainer is not None and trainer.precision == "16-mixed":
            return  # its scaler skips such steps
        # Each check synchronises a GPU; on a CPU it is free.
        is_checked = loss.device.type == "cpu" or self.global_step % _FINITE_CHECK_INTERVAL == 0
        if is_checked and not loss.isfinite():
            raise self._loss_fault(loss, batch)

    def _loss_fault(self, loss: Tensor, batch: Batch) -> ValueError:
        """Explain a loss that is not finite."""
        symptom = f"its loss is {loss.item()} in step {self.global_step}"
        found = batch.non_finite_samples() if isinstance(batch, FieldwiseBatch) else {}
        if found:
            places = ", ".join(f"{field} of {listed_samples(ids)}" for field, ids in found.items())
            return ValueError(
                f"the training has ended, {symptom}: the batch holds NaN or infinity in {places}; "
                "correct the data or their preparation, or where NaN means unknown, list the field "
                f"in {type(batch).__name__}.nan_fields"
            )
        if not self._has_finite_weights():
            return self._diverged(symptom)
        samples = listed_samples(batch.sample_ids)
        if self.global_step == 0:
            return ValueError(
                f"the training has ended, {symptom}, with finite weights and a finite batch "
                f"({samples}); correct the task's losses"
            )
        otherwise = f"; if the loss of {samples} is {loss.item()} before any step, correct it"
        return self._diverged(symptom, otherwise)

    def _diverged(self, symptom: str, otherwise: str = "") -> ValueError:
        """Make the error of a divergence, with a remedy for another cause."""
        if not otherwise and self.device.type != "cpu":  # not every loss is checked there
            otherwise = "; a sample with NaN does the same: --trainer.accelerator cpu tells which"
        return ValueError(
            f"the training has diverged, {symptom}; restart it in another --run_folder with a "
            "lower --model.init_args.optimizer.learning_rate, or with "
            f"--trainer.gradient_clip_val{otherwise}"
        )

    def _log_scores(self, stage: str) -> None:
        # float32: not every accelerator has more
        with naming_samples(tuple):
            scores = {f"{stage}/{name}": score.float() for name, score in self.scores().items()}
            self.notes = self.score_notes()
        check_collection(f"{type(self).__name__}.score_notes()", self.notes)
        with torch.inference_mode(mode=False):  # otherwise training could not use its tensors
            self.metric.reset()
        if self._scored_at is not None:
            self.log(STEP, float(self._scored_at[1]))  # else loggers would take step 0
        monitored, _ = self.monitored
        for name, score in scores.items():
            self.log(name, score, prog_bar=name == monitored)


def _check_resumable(checkpoint: Mapping[str, Any]) -> None:
    """Refuse a checkpoint without the state of a training, which Lightning resumes in part."""
    lacking = [
        key for key, kind in _TRAINING_STATE.items() if not isinstance(checkpoint.get(key), kind)
    ]
    if not lacking and not checkpoint["loops"].get("fit_loop"):
        lacking = ["loops"]
    if lacking:
        raise ValueError(
            f"the checkpoint cannot be resumed: it lacks {', '.join(lacking)}; name a last.ckpt, "
            "or start another run from its weights by --model.init_args.initial_weights"
        )


@rank_zero_only
def _log_picture(
    loggers: Iterable[Any], name: str, picture: UInt8[np.ndarray, "height width 3"], step: int
) -> None:
    """Give a picture to every logger.

    TensorBoard and loggers with `log_image`, such as Weights & Biases, show it; others, such as
    CSV files, get a file pictures/NAME/STEP.png in their folder, if they have one.

    Args:
        loggers: Loggers of the trainer, Lightning's or compatible ones.
        name: Name of the picture; the same name continues a series.
        picture: RGB picture.
        step: Number of the training step.
    """
    for logger in loggers:
        log_image: Any = getattr(logger, "log_image", None)
        if isinstance(logger, TensorBoardLogger):
            logger.experiment.add_image(name, picture, step, dataformats="HWC")
        elif log_image is not None:
            log_image(key=name, images=[picture], step=step)
        elif (folder := logger.log_dir or logger.save_dir) is not None:
            write_rgb(Path(folder) / "pictures" / name / f"{step:07}.png", picture)


def _num_epochs(trainer: lightning.Trainer) -> int:
    """Number of complete epochs, by the steps: Lightning's own differs after a resumption."""
    batches = trainer.num_training_batches
    if not 0 < batches < math.inf:
        return trainer.current_epoch
    return trainer.global_step // math.ceil(batches / trainer.accumulate_grad_batches)

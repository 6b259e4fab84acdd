"""Callbacks of the training: keep random states, log steps, write weights."""

import ctypes
import math
import random
import time
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from lightning import LightningModule, Trainer
from lightning.pytorch.callbacks import Callback, Checkpoint, ModelCheckpoint
from torch import Tensor
from torch.optim import Optimizer

from sightline.files.weights import read_checkpoint_weights, write_weights
from sightline.files.weights_header import RUN_WEIGHTS
from sightline.training.last_checkpoint import LastCheckpoint
from sightline.training.module import TrainingModule

_STATES_KEY = "sightline_random_states"
_MIN_CURVE_POINTS = 20  # number of points per curve in TensorBoard


class RandomState(Callback):
    """Callback that keeps the states of all global random generators of each rank in checkpoints.

    Our code uses generators passed as arguments; dropout and third-party layers do not.
    """

    def __init__(self) -> None:
        """Start without states to restore."""
        self._restored: dict[str, Any] | None = None

    def on_save_checkpoint(
        self, trainer: Trainer, pl_module: LightningModule, checkpoint: dict[str, Any]
    ) -> None:
        """Add the states."""
        del pl_module
        states: list[dict[str, Any]] = [_random_states()] * trainer.world_size
        if trainer.world_size > 1:
            torch.distributed.all_gather_object(states, _random_states())
        checkpoint[_STATES_KEY] = states

    def on_load_checkpoint(
        self, trainer: Trainer, pl_module: LightningModule, checkpoint: dict[str, Any]
    ) -> None:
        """Store the states of this rank, if the checkpoint contains them."""
        del pl_module
        states = checkpoint.get(_STATES_KEY, [])
        if trainer.global_rank < len(states):
            self._restored = states[trainer.global_rank]

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Restore the states, directly before the first training batch."""
        del trainer, pl_module
        if self._restored is not None:
            _set_random_states(self._restored)
            self._restored = None


class LogShortRuns(Callback):
    """Callback that logs often enough that a short run leaves a curve too."""

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Set the logging interval by the length of the run."""
        del pl_module
        steps = trainer.estimated_stepping_batches
        if math.isfinite(steps):
            interval = max(1, int(steps) // _MIN_CURVE_POINTS)
            current: int = trainer.log_every_n_steps  # type: ignore[attr-defined]
            trainer.log_every_n_steps = min(current, interval)  # type: ignore[attr-defined]


class ReturnFreeMemory(Callback):
    """Callback that returns freed memory to the system every few steps, where the C library can.

    glibc keeps freed tensors of up to 32 MB in its heap. Where each step has other sizes (points,
    regions), the gaps are seldom reused and a process grows by megabytes a step.
    """

    _EVERY_N_STEPS = 10

    def __init__(self) -> None:
        """Look the function up; C libraries other than glibc have none and keep no such heap."""
        self._trim = getattr(ctypes.CDLL(None), "malloc_trim", None)

    def on_train_batch_end(
        self,
        trainer: Trainer,
        pl_module: LightningModule,
        outputs: object,
        batch: object,
        batch_idx: int,
    ) -> None:
        """Return the memory."""
        del trainer, pl_module, outputs, batch
        if self._trim is not None and batch_idx % self._EVERY_N_STEPS == 0:
            self._trim(ctypes.c_size_t(0))


class LogSteps(Callback):
    """Callback that logs learning rate, norm of the unclipped gradients, and seconds per step.

    The seconds are the mean since the last point of the curve, with data loading, without
    validations.
    """

    def __init__(self) -> None:
        """Start with zero steps."""
        self._start_s = 0.0
        self._steps = 0

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Start the clock."""
        del trainer, pl_module
        self._restart()

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Restart the clock."""
        del trainer, pl_module
        self._restart()

    def on_before_optimizer_step(
        self, trainer: Trainer, pl_module: LightningModule, optimizer: Optimizer
    ) -> None:
        """Log rate and norm at the logger's interval."""
        if not _is_logged(trainer, trainer.global_step + 1):
            return
        groups = optimizer.param_groups
        gradients = [p.grad for group in groups for p in group["params"] if p.grad is not None]
        values = {"training/learning_rate": float(groups[0]["lr"])}
        if gradients:
            values["training/gradient_norm"] = float(torch.nn.utils.get_total_norm(gradients))
        pl_module.log_dict(values)

    def on_train_batch_end(
        self,
        trainer: Trainer,
        pl_module: LightningModule,
        outputs: object,
        batch: object,
        batch_idx: int,
    ) -> None:
        """Log the time at the logger's interval."""
        del outputs, batch, batch_idx
        self._steps += 1
        if _is_logged(trainer, trainer.global_step):
            seconds = (time.monotonic() - self._start_s) / self._steps
            pl_module.log("training/seconds_per_step", seconds)
            self._restart()

    def _restart(self) -> None:
        self._start_s, self._steps = time.monotonic(), 0


def _is_logged(trainer: Trainer, step: int) -> bool:
    interval: int = trainer.log_every_n_steps  # type: ignore[attr-defined]
    return interval > 0 and step % interval == 0


class _BestCheckpoint(ModelCheckpoint):
    """Checkpoint of the best score, the latest of equal ones; it survives a move of the folder."""

    num_saved: int = 0
    """Number of checkpoints saved in this process."""

    def check_monitor_top_k(self, trainer: Trainer, current: Tensor | None = None) -> bool:
        """Return whether the score is the best so far, or equals it.

        A score that stays 0 chooses nothing, as no label counts: then the last weights are kept.
        """
        is_equal = current is not None and current == self.best_model_score
        is_saved = super().check_monitor_top_k(trainer, current) or bool(is_equal)
        self.num_saved += is_saved
        return is_saved

    @property
    def state_key(self) -> str:
        """Key in checkpoints: that of `ModelCheckpoint`."""
        return super().state_key.replace(type(self).__qualname__, ModelCheckpoint.__qualname__, 1)

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Load the state; Lightning forgets the score if the folder has another path."""
        best = Path(self.dirpath or "") / Path(state_dict["best_model_path"]).name
        is_moved = state_dict.get("dirpath") != self.dirpath and state_dict["best_model_path"]
        if is_moved and best.is_file():
            moved = str(best)
            state_dict = state_dict | {
                "dirpath": self.dirpath,
                "best_model_path": moved,
                "kth_best_model_path": moved,
                "best_k_models": {moved: state_dict["best_model_score"]},
                "last_model_path": "",
            }
        super().load_state_dict(state_dict)


class WriteWeights(Checkpoint):
    """Callback that writes weights.safetensors: the best so far, or without `best` the last ones.

    The weights come from the checkpoints, so they are averages if weights are averaged; the module
    may convert them (`TrainingModule.final_weights`).
    """

    def __init__(self, folder: Path, last: LastCheckpoint, best: _BestCheckpoint | None) -> None:
        """Store the folder and the checkpoint callbacks, which must come before this callback."""
        self.path = folder / RUN_WEIGHTS
        self._last = last
        self._best = best
        self._num_written = -1  # a resumed run writes at its first validation

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Write if the validation was the best so far."""
        if self._best is None or trainer.sanity_checking:
            return
        if self._num_written != self._best.num_saved:
            self._num_written = self._best.num_saved
            self._write_best(trainer, pl_module, self._best)

    def on_fit_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Write if nothing was validated, or if a complete run is resumed and has no weights."""
        if self._best is None or self._best.best_model_score is None:
            self._write(trainer, pl_module, self._last.path, {})
        elif not self.path.is_file() or not self.path.stat().st_size:
            self._write_best(trainer, pl_module, self._best)

    def _write_best(
        self, trainer: Trainer, pl_module: LightningModule, best: _BestCheckpoint
    ) -> None:
        if best.best_model_score is not None:
            scores = {str(best.monitor): float(best.best_model_score)}
            self._write(trainer, pl_module, Path(best.best_model_path), scores)

    def _write(
        self,
        trainer: Trainer,
        pl_module: LightningModule,
        checkpoint: Path,
        scores: dict[str, float],
    ) -> None:
        if not trainer.is_global_zero or not checkpoint.is_file():
            return
        weights = read_checkpoint_weights(checkpoint)
        if isinstance(pl_module, TrainingModule):
            weights = pl_module.final_weights(weights)
        write_weights(
            self.path,
            weights.tensors,
            task=weights.task,
            config=weights.config,
            provenance=weights.provenance
            | {name: f"{score:.6g}" for name, score in scores.items()},
        )


def checkpoint_callbacks(
    folder: Path,
    *,
    every_n_steps: int,
    monitored: tuple[str, Literal["min", "max"]] | None,
    keep_last_weights: bool = False,
) -> list[Callback]:
    """Create the callbacks that make a run resumable and write its weights, in the required order.

    Args:
        folder: Folder of the run.
        every_n_steps: Interval of additional writes of last.ckpt.
        monitored: Score that selects the best weights, and its direction; None: no validation.
        keep_last_weights: Whether weights.safetensors has the last weights, not the best.
    """
    last = LastCheckpoint(folder, every_n_steps=every_n_steps)
    if monitored is None:
        return [RandomState(), last, WriteWeights(folder, last, None)]
    best = _BestCheckpoint(
        folder,
        "best",
        monitor=monitored[0],
        mode=monitored[1],
        save_on_train_epoch_end=False,  # saves after validations, before the weights
        enable_version_counter=False,
    )
    return [
        RandomState(),
        best,
        last,
        WriteWeights(folder, last, None if keep_last_weights else best),
    ]


def _random_states() -> dict[str, Any]:
    """Random states as plain values and tensors, which checkpoints may contain."""
    version, internal, gauss = random.getstate()
    name, keys, position, has_gauss, cached = np.random.get_state(legacy=True)  # noqa: NPY002 - the
    # global generator's state is kept here
    return {
        "python": [version, list(internal), gauss],
        "numpy": [str(name), torch.from_numpy(np.array(keys, dtype=np.int64)), position],
        "numpy_gauss": [has_gauss, cached],
        "torch": torch.get_rng_state(),
        "cuda": torch.cuda.get_rng_state() if torch.cuda.is_available() else None,
    }


def _set_random_states(states: dict[str, Any]) -> None:
    version, internal, gauss = states["python"]
    random.setstate((version, tuple(internal), gauss))
    name, keys, position = states["numpy"]
    np.random.set_state(  # noqa: NPY002 - as above
        (name, keys.numpy().astype(np.uint32), position, *states["numpy_gauss"])
    )
    torch.set_rng_state(states["torch"])
    if states["cuda"] is not None and torch.cuda.is_available():
        torch.cuda.set_rng_state(states["cuda"])

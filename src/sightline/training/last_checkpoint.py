"""Checkpoints for resuming a run, and interruption of a run from outside."""

import io
import os
from pathlib import Path
from typing import Any

import torch
from lightning import LightningModule, Trainer
from lightning.fabric.plugins import TorchCheckpointIO
from lightning.pytorch.callbacks import Checkpoint

from sightline.files.atomic import atomic_write_bytes
from sightline.files.plain_file import check_no_pointer
from sightline.files.weights_header import (
    find_weights,
    has_weights,
    read_description,
    shipped_names,
)
from sightline.training.interruption import DeferredInterruption

_LAST = "last.ckpt"
_VALIDATION_DUE_KEY = "sightline_owed_validation"


def check_checkpoint_file(path: Path, *, is_given: bool = True) -> None:
    """Refuse a path that leads to no checkpoint file, with what it leads to.

    Args:
        path: The file.
        is_given: Whether --ckpt_path names it; else the run folder does.

    Raises:
        ValueError: There is no such file, or it is the folder of a run, or weights alone.
    """
    if path.is_file():
        check_no_pointer(path)
    if str(path) in shipped_names() or (path.suffix == ".safetensors" and has_weights(path)):
        read_description(find_weights(path))  # of a damaged file, its own fault
        raise ValueError(
            f"{path} holds weights without the state of a training; name the .ckpt of a run with "
            f"--ckpt_path, or take the weights by --model.init_args.initial_weights {path}"
        )
    if (path / _LAST).is_file():
        raise ValueError(f"{path} is the folder of a run; give {path / _LAST}")
    if not path.is_file():
        remedy = "leave out --ckpt_path to start the run, or name another one with it"
        if not is_given:
            remedy = "name the folder of a training with --run_folder, or the file with --ckpt_path"
        raise ValueError(f"there is no checkpoint {path}; {remedy}")


class AtomicCheckpointIO(TorchCheckpointIO):
    """Plugin that writes checkpoints atomically in the folder of the run.

    Lightning's own takes room in the folder for temporary files, and may stop between there and the
    run's folder.
    """

    def save_checkpoint(
        self,
        checkpoint: dict[str, Any],
        path: str | os.PathLike[str],
        storage_options: Any | None = None,  # noqa: ANN401 - as base
    ) -> None:
        """Write a checkpoint; `storage_options` has no effect."""
        del storage_options
        content = io.BytesIO()
        torch.save(checkpoint, content)
        atomic_write_bytes(Path(path), content.getvalue())


class LastCheckpoint(Checkpoint):
    """Callback that writes last.ckpt: by steps, before validations, after epochs, when stopped.

    A checkpoint written before a validation marks it as due: a run that resumes from it validates
    first. So a run that is interrupted at any moment finds the same best weights.

    Ctrl-C and SIGTERM end the training after the current step; a second signal, or a step that
    takes too long, ends it at once. On several devices the latest written checkpoint remains: the
    ranks would not stop in the same step.
    """

    def __init__(self, folder: Path, *, every_n_steps: int) -> None:
        """Store the folder and the interval.

        Raises:
            ValueError: The interval is 0 steps.
        """
        if every_n_steps < 1:
            raise ValueError(f"checkpoint_every_n_steps must be at least 1, got {every_n_steps}")
        self.path = folder / _LAST
        self._every_n_steps = every_n_steps
        self._step = 0
        self._interruption = DeferredInterruption()
        self._validation_due = False
        self._resumed_due_step: int | None = None

    def on_save_checkpoint(
        self, trainer: Trainer, pl_module: LightningModule, checkpoint: dict[str, Any]
    ) -> None:
        """Mark the validation as due, if it is."""
        del trainer, pl_module
        if self._validation_due:
            checkpoint[_VALIDATION_DUE_KEY] = True
            _enter_validation(checkpoint["loops"]["fit_loop"])

    def on_load_checkpoint(
        self, trainer: Trainer, pl_module: LightningModule, checkpoint: dict[str, Any]
    ) -> None:
        """Store the step of a checkpoint with a due validation."""
        del trainer, pl_module
        if checkpoint.get(_VALIDATION_DUE_KEY):
            self._resumed_due_step = checkpoint["global_step"]

    def on_fit_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Add a step if the validation of the last step is due: the Trainer would stop at once."""
        del pl_module
        if self._resumed_due_step is not None and self._resumed_due_step == trainer.max_steps:
            trainer.fit_loop.epoch_loop.max_steps += 1

    def on_validation_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Remove the extra step of `on_fit_start`."""
        del pl_module
        if self._resumed_due_step is not None and self._resumed_due_step == trainer.max_steps - 1:
            trainer.fit_loop.epoch_loop.max_steps -= 1
        self._resumed_due_step = None

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Install the signal handlers."""
        del pl_module
        self._step = trainer.global_step
        if trainer.world_size == 1:
            self._interruption.install()

    def on_train_batch_end(
        self,
        trainer: Trainer,
        pl_module: LightningModule,
        outputs: object,
        batch: object,
        batch_idx: int,
    ) -> None:
        """Write at the interval, and end the training if requested."""
        del pl_module, outputs, batch, batch_idx
        if trainer.global_step == self._step:
            return  # gradients are being accumulated; no checkpoint holds those
        self._step = trainer.global_step
        self._interruption.cancel_timeout()
        epoch_loop, fetcher = trainer.fit_loop.epoch_loop, trainer.fit_loop._data_fetcher  # noqa: SLF001
        assert fetcher is not None, "a batch came from it"
        self._validation_due = epoch_loop._should_check_val_fx(fetcher)  # noqa: SLF001
        is_interval = trainer.global_step % self._every_n_steps == 0
        if is_interval or self._validation_due or self._interruption.number is not None:
            self._write(trainer)
        self._validation_due = False
        self._interruption.raise_pending()

    def on_validation_batch_end(
        self,
        trainer: Trainer,
        pl_module: LightningModule,
        outputs: object,
        batch: object,
        batch_idx: int,
        dataloader_idx: int = 0,
    ) -> None:
        """End the training if requested: last.ckpt marks this validation as due."""
        del trainer, pl_module, outputs, batch, batch_idx, dataloader_idx
        self._interruption.raise_pending()

    def on_train_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Write the checkpoint."""
        del pl_module
        self._write(trainer)

    def teardown(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Restore the signal handlers."""
        del trainer, pl_module, stage
        self._interruption.restore_handlers()

    def on_exception(
        self, trainer: Trainer, pl_module: LightningModule, exception: BaseException
    ) -> None:
        """Restore the signal handlers."""
        del trainer, pl_module, exception
        self._interruption.restore_handlers()

    def _write(self, trainer: Trainer) -> None:
        trainer.save_checkpoint(self.path)  # by all ranks; the first writes the file


def _enter_validation(fit_loop: dict[str, Any]) -> None:
    """Move the Trainer's progress from the end of a step into the validation after it.

    The Trainer then resumes such a checkpoint with the validation instead of the next step.
    """
    trained, validated = (
        fit_loop[f"epoch_loop.{name}batch_progress"] for name in ("", "val_loop.")
    )
    for span in ("total", "current"):
        trained[span]["completed"] = trained[span]["processed"]
        done = 0 if span == "current" else validated[span]["completed"]
        started = done + 1
        validated[span] |= {
            "ready": started,
            "started": started,
            "processed": done,
            "completed": done,
        }

"""Progress of a run: bars on a terminal, lines in a file."""

import math
import time
from typing import Protocol, runtime_checkable

from lightning import LightningModule, Trainer
from lightning.pytorch.callbacks import ProgressBar
from lightning.pytorch.trainer.states import TrainerFn
from rich.console import Console
from rich.progress import TaskID

from sightline.jobs.progress import ProgressLines, progress_bars
from sightline.training.module import TrainingModule

_UPDATE_INTERVAL_S = 0.5  # interval of reading the loss, which synchronises an accelerator


@runtime_checkable  # for beartype, which checks arguments under pytest
class _Display(Protocol):
    """Display of named jobs with many pieces on stderr."""

    def show(self, name: str, done: int, total: int | None, note: str = "") -> None:
        """Show the number of finished pieces of a job; total None: unknown."""

    def end(self, name: str) -> None:
        """End the display of a job."""

    def say(self, text: str) -> None:
        """Print a permanent line."""

    def close(self) -> None:
        """Close the display."""


class _Bars:
    """Display with one bar per job."""

    def __init__(self, console: Console) -> None:
        self._progress = progress_bars(console)
        self._tasks: dict[str, TaskID] = {}
        self._progress.start()

    def show(self, name: str, done: int, total: int | None, note: str = "") -> None:
        description = f"{name}{note and f', {note}'}"
        if name not in self._tasks:
            self._tasks[name] = self._progress.add_task(description, total=total, completed=done)
        self._progress.update(self._tasks[name], completed=done, description=description)

    def end(self, name: str) -> None:
        if name in self._tasks:
            self._progress.remove_task(self._tasks.pop(name))

    def say(self, text: str) -> None:
        self._progress.console.print(text, highlight=False, markup=False, soft_wrap=True)

    def close(self) -> None:
        self._progress.stop()


class RunProgress(ProgressBar):
    """Display of the steps of the whole run, the batches of each validation, and its score."""

    def __init__(self) -> None:
        """Start without a display."""
        super().__init__()
        self._is_enabled = True
        self._display: _Display | None = None
        self._updated_s = -math.inf
        self._printed_notes: set[str] = set()

    def disable(self) -> None:
        """Disable the display in this process: another one has it."""
        self._is_enabled = False

    def enable(self) -> None:
        """Enable the display again."""
        self._is_enabled = True

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Show the position in the run."""
        del pl_module
        self._show_training(trainer)

    def on_train_batch_end(
        self,
        trainer: Trainer,
        pl_module: LightningModule,
        outputs: object,
        batch: object,
        batch_idx: int,
    ) -> None:
        """Update the number of finished batches."""
        del pl_module, outputs, batch, batch_idx
        self._show_training(trainer)

    def on_validation_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Show the start of the validation."""
        del pl_module
        self._show("validation", 0, self._num_batches(trainer))

    def on_validation_batch_end(
        self,
        trainer: Trainer,
        pl_module: LightningModule,
        outputs: object,
        batch: object,
        batch_idx: int,
        dataloader_idx: int = 0,
    ) -> None:
        """Update the number of finished batches."""
        del pl_module, outputs, batch, dataloader_idx
        self._show("validation", batch_idx + 1, self._num_batches(trainer))

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Print the score that selects the best weights."""
        display = self._displayed()
        if display is None:
            return
        display.end("validation")
        if trainer.sanity_checking or not isinstance(pl_module, TrainingModule):
            return
        name, _ = pl_module.monitored
        if name in trainer.callback_metrics:
            score = float(trainer.callback_metrics[name])
            # `validate` of a checkpoint has no step; trainer.validating is true within fit too
            is_single_validation = (
                trainer.state.fn is TrainerFn.VALIDATING and trainer.ckpt_path is not None
            )
            step = "" if is_single_validation else f"step {trainer.global_step}: "
            beside = "".join(
                f", {each} {float(trainer.callback_metrics[each]):.6g}"
                for each in pl_module.monitored_beside
                if each in trainer.callback_metrics
            )
            display.say(f"{step}{name} {score:.6g}{beside}")
            for note in pl_module.notes:
                if note not in self._printed_notes:
                    self._printed_notes.add(note)
                    display.say(note)

    def on_test_batch_end(
        self,
        trainer: Trainer,
        pl_module: LightningModule,
        outputs: object,
        batch: object,
        batch_idx: int,
        dataloader_idx: int = 0,
    ) -> None:
        """Update the number of finished batches."""
        del pl_module, outputs, batch, dataloader_idx
        total = trainer.num_test_batches[0]
        self._show("test", batch_idx + 1, int(total) if math.isfinite(total) else None)

    def teardown(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Remove the bars."""
        del trainer, pl_module, stage
        self._close()

    def on_exception(
        self, trainer: Trainer, pl_module: LightningModule, exception: BaseException
    ) -> None:
        """Remove the bars."""
        del trainer, pl_module, exception
        self._close()

    def _show_training(self, trainer: Trainer) -> None:
        now = time.monotonic()
        if now - self._updated_s < _UPDATE_INTERVAL_S:
            return
        self._updated_s = now
        steps = trainer.estimated_stepping_batches
        loss = trainer.progress_bar_metrics.get("loss")
        note = "" if loss is None else f"loss {float(loss):.4g}"
        total = int(steps) if math.isfinite(steps) else None
        self._show("training", trainer.global_step, total, note)

    def _show(self, name: str, done: int, total: int | None, note: str = "") -> None:
        display = self._displayed()
        if display is not None:
            display.show(name, done, total, note)

    def _num_batches(self, trainer: Trainer) -> int | None:
        counts = (
            trainer.num_sanity_val_batches if trainer.sanity_checking else trainer.num_val_batches
        )
        total = sum(counts) if isinstance(counts, list) else counts
        return int(total) if math.isfinite(total) else None

    def _displayed(self) -> _Display | None:
        """Display of this process; None: it has none."""
        if self._is_enabled and self._display is None:
            console = Console(stderr=True)
            self._display = _Bars(console) if console.is_terminal else ProgressLines()
        return self._display if self._is_enabled else None

    def _close(self) -> None:
        if self._display is not None:
            self._display.close()
            self._display = None

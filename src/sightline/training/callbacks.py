"""What goes on around the training: states kept, checkpoints and weights written."""

import random
import signal
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import torch
from lightning import LightningModule, Trainer
from lightning.pytorch.callbacks import Callback, Checkpoint, ModelCheckpoint

from sightline.training.checkpoint import read_checkpoint_weights, write_weights

_STATES_KEY = "sightline_random_states"


class RandomState(Callback):
    """Keeps the states of all global random generators in checkpoints, each rank's own.

    Our code draws from generators that are passed in; dropout and other people's layers do not.
    """

    def __init__(self) -> None:
        """Has nothing to restore yet."""
        self._restored: dict[str, Any] | None = None

    def on_save_checkpoint(
        self, trainer: Trainer, pl_module: LightningModule, checkpoint: dict[str, Any]
    ) -> None:
        """Adds the states."""
        del pl_module
        states: list[dict[str, Any]] = [_random_states()] * trainer.world_size
        if trainer.world_size > 1:
            torch.distributed.all_gather_object(states, _random_states())
        checkpoint[_STATES_KEY] = states

    def on_load_checkpoint(
        self, trainer: Trainer, pl_module: LightningModule, checkpoint: dict[str, Any]
    ) -> None:
        """Takes the states of this rank, if there was such a rank."""
        del pl_module
        states = checkpoint.get(_STATES_KEY, [])
        if trainer.global_rank < len(states):
            self._restored = states[trainer.global_rank]

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Restores them: after all that comes before the training, before its first batch."""
        del trainer, pl_module
        if self._restored is not None:
            _set_random_states(self._restored)
            self._restored = None


class LastCheckpoint(Checkpoint):
    """Writes last.ckpt every so many steps, after each epoch and on Ctrl-C.

    Ctrl-C ends the training after the step that it comes in; a second one ends it at once. On
    several devices the latest written checkpoint stands: the ranks would not stop in the same step.
    """

    def __init__(self, folder: Path, *, every_n_steps: int) -> None:
        """Takes where to and how often.

        Raises:
            ValueError: It is to be written every 0 steps.
        """
        if every_n_steps < 1:
            raise ValueError(f"checkpoint_every_n_steps must be at least 1, got {every_n_steps}")
        self.path = folder / "last.ckpt"
        self._every_n_steps = every_n_steps
        self._step = 0
        self._interrupted = False
        self._previous_handler: Any = None

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Takes over Ctrl-C."""
        del pl_module
        self._step = trainer.global_step
        if trainer.world_size == 1:
            self._previous_handler = signal.signal(signal.SIGINT, self._note_interrupt)

    def on_train_batch_end(
        self,
        trainer: Trainer,
        pl_module: LightningModule,
        outputs: object,
        batch: object,
        batch_idx: int,
    ) -> None:
        """Writes where it is time, and ends the training after Ctrl-C."""
        del pl_module, outputs, batch, batch_idx
        if trainer.global_step == self._step:
            return  # gradients are being accumulated; no checkpoint holds those
        self._step = trainer.global_step
        if self._interrupted or trainer.global_step % self._every_n_steps == 0:
            self._write(trainer)
        if self._interrupted:
            raise KeyboardInterrupt

    def on_train_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Writes."""
        del pl_module
        self._write(trainer)

    def teardown(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Gives Ctrl-C back."""
        del trainer, pl_module, stage
        self._give_back()

    def on_exception(
        self, trainer: Trainer, pl_module: LightningModule, exception: BaseException
    ) -> None:
        """Gives Ctrl-C back."""
        del trainer, pl_module, exception
        self._give_back()

    def _note_interrupt(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        self._interrupted = True
        self._give_back()

    def _give_back(self) -> None:
        if self._previous_handler is not None:
            signal.signal(signal.SIGINT, self._previous_handler)
            self._previous_handler = None

    def _write(self, trainer: Trainer) -> None:
        # All ranks take part in making the checkpoint, the first writes it.
        aside = self.path.with_name(".last.ckpt.part")
        trainer.save_checkpoint(aside)
        if trainer.is_global_zero:
            aside.replace(self.path)


class WriteWeights(Checkpoint):
    """Writes the best weights so far, without a validation the last ones, as weights.safetensors.

    They are taken from the checkpoints, so that they are averages where weights are averaged.
    """

    def __init__(self, folder: Path, last: LastCheckpoint, best: ModelCheckpoint | None) -> None:
        """Takes where to, and who writes the checkpoints; those must come before this callback."""
        self.path = folder / "weights.safetensors"
        self._last = last
        self._best = best
        self._written_score: float | None = None

    def on_validation_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Writes if the validation was the best so far."""
        del pl_module
        if self._best is None or trainer.sanity_checking or self._best.best_model_score is None:
            return
        score = float(self._best.best_model_score)
        if score != self._written_score:
            self._written_score = score
            self._write(trainer, Path(self._best.best_model_path), {str(self._best.monitor): score})

    def on_train_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Writes if nothing was validated."""
        del pl_module
        if self._best is None or self._best.best_model_score is None:
            self._write(trainer, self._last.path, {})

    def _write(self, trainer: Trainer, checkpoint: Path, scores: dict[str, float]) -> None:
        if not trainer.is_global_zero or not checkpoint.is_file():
            return
        weights = read_checkpoint_weights(checkpoint)
        write_weights(
            self.path,
            weights.tensors,
            task=weights.task,
            config=weights.config,
            provenance=weights.provenance
            | {name: f"{score:.6g}" for name, score in scores.items()},
        )


def _random_states() -> dict[str, Any]:
    """Plain values and tensors, which a checkpoint may hold."""
    version, internal, gauss = random.getstate()
    name, keys, position, has_gauss, cached = np.random.get_state(legacy=True)  # noqa: NPY002 - the
    # global generator is what is kept here
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

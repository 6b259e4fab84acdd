"""Trains on two processes, then resumes: `python -m tests.training.two_ranks FRAMES FOLDER`.

A program of its own, so that it can fork: its processes begin with all imported, and the test's
threads are not in their way.
"""

import shutil
import sys
from pathlib import Path

import torch
from lightning.pytorch.callbacks import Callback

from sightline.training.callbacks import LastCheckpoint, RandomState
from tests.training import toy

STOPPED_AFTER = 3
"""Steps of the part before the resumed one; an epoch has two."""


class Report(Callback):
    """Writes what each rank saw and has at the end, and keeps a checkpoint of the middle."""

    def __init__(self, folder):
        self.folder = folder

    def on_train_batch_start(self, trainer, *_):
        last = self.folder / "last.ckpt"
        if trainer.global_step == STOPPED_AFTER and trainer.is_global_zero and last.is_file():
            shutil.copy(last, self.folder / "middle.ckpt")

    def on_train_end(self, trainer, pl_module):
        report = {"seen": pl_module.seen, "state": pl_module.state_dict()}
        torch.save(report, self.folder / f"rank{trainer.global_rank}.pt")


def train(frames, folder, *, batch_size, resume=None, **settings):
    """Two epochs, without what is each device's own: dropout's draws, the batches' statistics."""
    folder.mkdir()
    callbacks = [RandomState(), LastCheckpoint(folder, every_n_steps=1), Report(folder)]
    module = toy.module(dropout=0.0)
    module.network.layers[1] = torch.nn.Identity()
    trainer = toy.trainer(folder, callbacks=callbacks, **settings)
    trainer.fit(module, datamodule=toy.data(frames, batch_size=batch_size), ckpt_path=resume)


def main(frames, folder):
    two = {"batch_size": 2, "devices": 2, "strategy": "ddp_fork"}
    train(frames, folder / "whole", **two)
    train(frames, folder / "resumed", resume=folder / "whole" / "middle.ckpt", **two)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))

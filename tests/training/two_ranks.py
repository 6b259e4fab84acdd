"""Trains on two processes, resumes, scores: `python -m tests.training.two_ranks FRAMES FOLDER`.

The resumed training reads shards of the frames. A separate program, so that it can fork: its
processes start with all imports done and without the threads of the test.
"""

import shutil
import sys
from pathlib import Path

import torch
from lightning.pytorch.callbacks import Callback

from sightline.data.formats.kitti_labels import parse_objects
from sightline.data.sharding import write_shards
from sightline.evaluation.kitti_object_metric import KittiObjectMetric
from sightline.evaluation.kitti_object_rules import LOOSE
from sightline.training.callbacks import RandomState
from sightline.training.last_checkpoint import LastCheckpoint
from tests.evaluation.kitti_scenes import random_street
from tests.training import toy

STOPPED_AFTER = 3
"""Steps of the part before the resumed one; an epoch has two."""


class Report(Callback):
    """Callback that writes each rank's samples and final state, and keeps a middle checkpoint."""

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
    """Train for two epochs without dropout and batch statistics, which differ between devices."""
    folder.mkdir()
    callbacks = [RandomState(), LastCheckpoint(folder, every_n_steps=1), Report(folder)]
    module = toy.module(dropout=0.0)
    module.network.layers[1] = torch.nn.Identity()
    trainer = toy.trainer(folder, callbacks=callbacks, **settings)
    trainer.fit(module, datamodule=toy.data(frames, batch_size=batch_size), ckpt_path=resume)


class Detector(toy.ToyModule):
    """Module scored by KITTI's AP on simulated results of each frame, besides its own scores."""

    def __init__(self, folder):
        super().__init__()
        self.folder = folder
        self.objects = KittiObjectMetric(LOOSE)
        self.files = random_street(11, num_frames=9)

    def score(self, batch):
        super().score(batch)
        files = [self.files[int(name)] for name in batch.sample_ids]
        self.objects.update(
            [parse_objects(found.encode(), "results", with_scores=True) for _, found in files],
            [parse_objects(labels.encode(), "labels", with_scores=False) for labels, _ in files],
        )

    def scores(self):
        found = super().scores() | self.objects.compute()
        torch.save(found, self.folder / f"rank{self.trainer.global_rank}.pt")
        return found


def score(frames, folder, *, batch_size, **settings):
    """Score all nine frames: an odd number for two ranks."""
    folder.mkdir()
    torch.manual_seed(0)
    module = Detector(folder)
    data = toy.data(
        frames, validation=(toy.SourceConfig(path=Path()),), validation_batch_size=batch_size
    )
    toy.trainer(folder, **settings).validate(module, datamodule=data, verbose=False)


def main(frames, folder):
    two = {"batch_size": 2, "devices": 2, "strategy": "ddp_fork"}
    train(frames, folder / "whole", **two)
    shards = folder / "shards"
    write_shards(frames, shards, frames_per_shard=4)
    train(shards, folder / "resumed", resume=folder / "whole" / "middle.ckpt", **two)
    for size in (1, 2):
        score(frames, folder / f"scores{size}", **two | {"batch_size": size})


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))

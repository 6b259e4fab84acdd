"""Resumed trainings equal uninterrupted ones."""

import contextlib
import os
import random
import signal
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from lightning.pytorch.callbacks import Callback, EMAWeightAveraging

from sightline.data.sharding import write_shards
from sightline.training.callbacks import RandomState
from sightline.training.last_checkpoint import LastCheckpoint
from tests import shape_checks
from tests.training import toy

STEPS_PER_EPOCH = 4
VALIDATED = {"validation": (toy.SourceConfig(path=Path()),)}


class KilledError(Exception):
    """Simulated crash of the machine."""


class Kill(Callback):
    """Callback that ends the training in the step after the given one."""

    def __init__(self, step):
        self.step = step

    def on_train_batch_start(self, trainer, *_):
        if trainer.global_step == self.step:
            raise KilledError


def train(frames, folder, *, every=100, kill=None, resume=None, averaged=False, **settings):
    """Train for 6 steps; returns the module and the path of its last checkpoint."""
    last = LastCheckpoint(folder, every_n_steps=every)
    callbacks = [RandomState(), last]
    callbacks += [EMAWeightAveraging(decay=0.8)] if averaged else []
    callbacks += [Kill(kill)] if kill is not None else []
    data = {name: settings.pop(name) for name in ("workers", "validation") if name in settings}
    module = toy.module()
    trainer = toy.trainer(
        folder, callbacks=callbacks, **{"max_steps": 6, "max_epochs": -1} | settings
    )
    try:
        trainer.fit(module, datamodule=toy.data(frames, **data), ckpt_path=resume)
    except KilledError:
        assert kill is not None
    return module, last.path


def assert_same_end(resumed, uninterrupted):
    """Check that weights are equal bit for bit, and the batches of the training too."""
    for name, tensor in uninterrupted.state_dict().items():
        assert torch.equal(resumed.state_dict()[name], tensor), name
    count = len(resumed.seen)
    assert 0 < count < len(uninterrupted.seen)
    assert resumed.seen == uninterrupted.seen[-count:]
    assert resumed.images == uninterrupted.images[-count:]


@pytest.mark.parametrize("averaged", [False, True], ids=["", "averaged"])
@pytest.mark.parametrize("step", [3, STEPS_PER_EPOCH, 5])
def test_resuming_gives_the_weights_of_the_uninterrupted_training(frames, tmp_path, step, averaged):
    whole, _ = train(frames, tmp_path / "whole", averaged=averaged)
    _, last = train(frames, tmp_path / "part", every=step, kill=step, averaged=averaged)
    resumed, _ = train(frames, tmp_path / "part", resume=last, averaged=averaged)
    assert len(resumed.seen) == 6 - step
    assert_same_end(resumed, whole)


def test_resuming_with_workers_gives_what_no_workers_give(frames, tmp_path):
    whole, _ = train(frames, tmp_path / "whole", workers=0)
    _, last = train(frames, tmp_path / "part", every=3, kill=3, workers=2)
    resumed, _ = train(frames, tmp_path / "part", resume=last, workers=2)
    assert_same_end(resumed, whole)


def test_resuming_from_shards_gives_what_the_folder_gives(frames, tmp_path):
    shards = tmp_path / "shards"
    write_shards(frames, shards, frames_per_shard=4)
    whole, _ = train(frames, tmp_path / "whole", workers=0)
    _, last = train(shards, tmp_path / "part", every=3, kill=3, workers=2)
    resumed, _ = train(shards, tmp_path / "part", resume=last, workers=2)
    assert_same_end(resumed, whole)


@pytest.mark.parametrize(
    ("every", "kill", "settings"),
    [
        (4, 4, {"max_epochs": 2, "max_steps": -1} | VALIDATED),
        (3, 3, {"max_epochs": 2, "max_steps": -1, "val_check_interval": 3} | VALIDATED),
        (100, 5, {"max_epochs": 2, "max_steps": -1}),
        (1, 3, {"max_epochs": 3, "max_steps": -1, "limit_train_batches": 2}),
        (1, 4, {"max_epochs": 3, "max_steps": -1, "limit_train_batches": 0.75}),
        (1, 3, {"max_epochs": 2, "max_steps": -1, "accumulate_grad_batches": 2}),
        (2, 2, {"gradient_clip_val": 0.1, "precision": "bf16-mixed"}),
    ],
    ids=["validation", "validation-within", "epoch-end", "limit", "share", "accumulation", "bf16"],
)  # fmt: skip
def test_it_does_so_under_other_settings_of_the_trainer(frames, tmp_path, every, kill, settings):
    whole, _ = train(frames, tmp_path / "whole", **settings)
    _, last = train(frames, tmp_path / "part", every=every, kill=kill, **settings)
    resumed, _ = train(frames, tmp_path / "part", resume=last, **settings)
    assert_same_end(resumed, whole)


def test_without_the_random_states_dropout_would_differ(frames, tmp_path):
    # Shows that the tests above can fail: the network draws from the global generator.
    whole, _ = train(frames, tmp_path / "whole")
    _, last = train(frames, tmp_path / "part", every=3, kill=3)
    checkpoint = torch.load(last, weights_only=True)
    del checkpoint["sightline_random_states"]
    torch.save(checkpoint, last)
    resumed, _ = train(frames, tmp_path / "part", resume=last)
    assert resumed.seen == whole.seen[-3:]
    name = "network.layers.0.weight"
    assert not torch.equal(resumed.state_dict()[name], whole.state_dict()[name])


@pytest.mark.parametrize(
    "key", ["epoch", "global_step", "loops", "callbacks", "optimizer_states", "lr_schedulers"]
)
def test_a_checkpoint_of_the_weights_alone_is_refused(frames, tmp_path, key):
    _, last = train(frames, tmp_path, every=3, kill=3)
    checkpoint = torch.load(last, weights_only=True)
    checkpoint[key] = {} if key == "loops" else None
    torch.save(checkpoint, last)
    with pytest.raises(ValueError, match=f"cannot be resumed: it lacks {key}; name a last.ckpt"):
        train(frames, tmp_path, resume=last)


def test_all_global_generators_go_on_where_they_were(frames, tmp_path, monkeypatch):
    # Type checks draw items of collections from Python's generator: all calls must have them.
    monkeypatch.setattr(shape_checks, "MAX_CHECKED", sys.maxsize)

    class Draw(Callback):
        def __init__(self):
            self.drawn = []

        def on_train_batch_start(self, *_):
            self.drawn.append((random.random(), np.random.rand(), float(torch.rand(()))))  # noqa: NPY002

    def draw(folder, **settings):
        last, drawn = LastCheckpoint(folder, every_n_steps=3), Draw()
        callbacks = [RandomState(), drawn, last, *settings.pop("callbacks", [])]
        trainer = toy.trainer(folder, callbacks=callbacks, max_steps=6, max_epochs=-1)
        with contextlib.suppress(KilledError):
            trainer.fit(toy.module(), datamodule=toy.data(frames), **settings)
        return drawn.drawn, last.path

    whole, _ = draw(tmp_path / "whole")
    _, last = draw(tmp_path / "part", callbacks=[Kill(3)])
    resumed, _ = draw(tmp_path / "part", ckpt_path=last)
    assert resumed == whole[3:]


@pytest.mark.parametrize("workers", [0, 2])
def test_ctrl_c_leaves_a_checkpoint_of_the_step_it_came_in(frames, tmp_path, workers):
    class PressCtrlC(Callback):
        def on_train_batch_start(self, trainer, *_):
            if trainer.global_step == 1:
                os.kill(os.getpid(), signal.SIGINT)

    previous = signal.getsignal(signal.SIGINT)
    last = LastCheckpoint(tmp_path, every_n_steps=100)
    trainer = toy.trainer(tmp_path, callbacks=[RandomState(), last, PressCtrlC()])
    with pytest.raises(SystemExit):
        trainer.fit(toy.module(), datamodule=toy.data(frames, workers=workers))
    signal.signal(signal.SIGINT, previous)  # Lightning leaves it disabled
    assert torch.load(last.path, weights_only=True)["global_step"] == 2


def test_ctrl_c_is_given_back_after_the_training(frames, tmp_path):
    previous = signal.getsignal(signal.SIGINT)
    train(frames, tmp_path, max_steps=1)
    assert signal.getsignal(signal.SIGINT) is previous

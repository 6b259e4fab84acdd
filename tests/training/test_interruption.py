"""Interrupted and resumed runs equal uninterrupted ones."""

import contextlib
import multiprocessing
import os
import signal
import time
from pathlib import Path

import pytest
import torch
from lightning.pytorch.callbacks import Checkpoint

from sightline.data.datasets.kitti_object import KittiObjectDataset
from sightline.files.weights import read_weights
from sightline.training.callbacks import checkpoint_callbacks
from sightline.training.interruption import (
    Interruption,
    ending_by_signals,
    ignore_interruptions,
    terminating_workers,
)
from tests.training import toy

HOOKS = (
    "on_train_batch_start",
    "on_train_batch_end",
    "on_validation_start",
    "on_validation_batch_end",
    "on_validation_end",
    "on_train_epoch_end",
)
SETTINGS = {
    "epochs": {"max_epochs": 3},
    "steps": {"max_steps": 9, "max_epochs": -1},
    "within": {"max_epochs": 3, "val_check_interval": 2},
}


class KilledError(Exception):
    """Simulated crash of the machine."""


class Strike(Checkpoint):
    """Callback that runs an action at one hook call of a run, counted from 0."""

    def __init__(self, number, action):
        self.number = number
        self.action = action
        self.count = 0

    def strike(self, trainer, *_):
        if trainer.sanity_checking:
            return
        if self.count == self.number:
            self.action()
        self.count += 1


for hook in HOOKS:
    setattr(Strike, hook, Strike.strike)


def kill():
    raise KilledError


def run(frames, folder, strike, *, every=100, place=None, **settings):
    """Train for three epochs of three steps, resuming if possible; returns the interruption."""
    module = toy.module(warm_up_share=0.0, schedule="cosine")
    callbacks = checkpoint_callbacks(folder, every_n_steps=every, monitored=module.monitored)
    callbacks.insert(len(callbacks) if place is None else place, strike)
    trainer = toy.trainer(folder, callbacks=callbacks, **settings)
    last = folder / "last.ckpt"
    data = toy.data(
        frames,
        batch_size=3,
        validation=(toy.SourceConfig(path=Path()),),
        validation_batch_size=5,
    )
    with ending_by_signals(), contextlib.suppress(KilledError):
        try:
            trainer.fit(module, datamodule=data, ckpt_path=last if last.is_file() else None)
        except SystemExit as end:
            return end.__context__
    return None


@pytest.fixture(autouse=True, scope="module")
def _frames_stay_in_memory():
    """Read each frame once: it took a third of these hundreds of runs, and is tested elsewhere."""
    read, kept = KittiObjectDataset.__getitem__, {}

    def read_once(dataset, index):
        frame = dataset.root, dataset.sample_ids[index]
        if frame not in kept:
            kept[frame] = read(dataset, index)
        return kept[frame]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(KittiObjectDataset, "__getitem__", read_once)
        yield


def results(folder):
    """Results of a run: its last weights, its best weights, and the bytes of the weights file."""
    last, best = (read_weights(folder / f"{name}.ckpt") for name in ("last", "best"))
    return last, best, (folder / "weights.safetensors").read_bytes()


def assert_same(found, expected):
    for ours, theirs in zip(found[:2], expected[:2], strict=True):
        assert ours.provenance == theirs.provenance
        for name, tensor in theirs.tensors.items():
            assert torch.equal(ours.tensors[name], tensor), name
    assert found[2] == expected[2]


@pytest.fixture(scope="module", params=SETTINGS)
def whole(request, frames, tmp_path_factory):
    """Settings of a run, results of the uninterrupted run, and the number of its hook calls."""
    folder, counted = tmp_path_factory.mktemp("whole"), Strike(-1, kill)
    settings = SETTINGS[request.param]
    assert run(frames, folder, counted, **settings) is None
    return settings, results(folder), counted.count


def test_a_run_that_is_killed_anywhere_ends_with_the_uninterrupted_weights(whole, frames, tmp_path):
    settings, expected, count = whole
    for number in range(count):
        folder, every = tmp_path / str(number), (1, 100)[number % 2]
        run(frames, folder, Strike(number, kill), every=every, **settings)
        run(frames, folder, Strike(-1, kill), every=every, **settings)
        assert_same(results(folder), expected)


def test_so_does_one_that_is_killed_between_two_files(whole, frames, tmp_path):
    settings, expected, count = whole
    for place in (2, 3):  # after the best and after the last checkpoint, before the weights
        for number in range(5, count, 7):
            folder = tmp_path / f"{place}-{number}"
            run(frames, folder, Strike(number, kill), every=1, place=place, **settings)
            run(frames, folder, Strike(-1, kill), every=1, **settings)
            assert_same(results(folder), expected)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_so_does_one_that_is_stopped_by_a_signal_anywhere(whole, frames, tmp_path, number):
    settings, expected, count = whole
    stopped = 0
    for place in range(number % 3, count, 3):  # each signal takes a third of the hook calls
        folder = tmp_path / str(place)
        ended = run(frames, folder, Strike(place, lambda: os.kill(os.getpid(), number)), **settings)
        if ended is not None:  # else it came after the last step
            assert isinstance(ended, Interruption)
            assert ended.exit_status == 128 + number
            assert (folder / "last.ckpt").is_file()
            run(frames, folder, Strike(-1, kill), **settings)
            stopped += 1
        assert_same(results(folder), expected)
    assert stopped > 0.25 * count


def run_until_a_signal(worker, is_ready):
    worker.start()
    assert is_ready.wait(60)
    raise Interruption("", signal.SIGHUP)


def wait_as_a_worker(is_ready):
    ignore_interruptions()
    is_ready.set()
    time.sleep(120)


def test_a_worker_that_an_interrupted_run_leaves_ends_by_the_signal_of_pythons_exit():
    is_ready = multiprocessing.Event()
    worker = multiprocessing.Process(target=wait_as_a_worker, args=(is_ready,), daemon=True)
    with pytest.raises(Interruption), terminating_workers():
        run_until_a_signal(worker, is_ready)
    worker.terminate()  # as Python does at exit, before it waits without a limit
    worker.join(60)
    assert worker.exitcode == -signal.SIGTERM


def test_processes_of_before_stay():
    is_ready = multiprocessing.Event()
    other = multiprocessing.Process(target=wait_as_a_worker, args=(is_ready,), daemon=True)
    other.start()
    assert is_ready.wait(60)
    with pytest.raises(Interruption), terminating_workers():
        raise Interruption("", signal.SIGHUP)
    other.terminate()
    other.join(2)
    assert other.is_alive()  # it ignores its first signal
    other.kill()
    other.join(60)

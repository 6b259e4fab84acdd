"""Loading ends with an error if workers cannot send batches, hang or die."""

import errno
import gc
import os
import signal
import time

import pytest
import torch
from torch import Tensor
from torch.utils.data import BatchSampler, Dataset, SequentialSampler

from sightline.training import interruption, loader
from sightline.training.interruption import DeferredInterruption, Interruption
from sightline.training.loader import BatchLoader


class Batches(Dataset[Tensor]):
    """Data set of tensors of the batch's number, with an action before each batch."""

    def __init__(self, action=None):
        self._action = action

    def __len__(self):
        return 3

    def __getitems__(self, keys):
        if self._action is not None:
            self._action()
        return torch.full((2, 2), float(keys[0]))


def load(action=None, workers=2):
    samples = Batches(action)
    batches = BatchSampler(SequentialSampler(samples), 1, drop_last=False)
    return [float(batch[0, 0]) for batch in BatchLoader(samples, batches, workers=workers, seed=0)]


def no_room(*_):
    raise RuntimeError("unable to write to file </torch_1_2>: No space left on device (28)")


def not_sendable():
    raise type("LocalError", (Exception,), {})


def test_batches_come_through_pipes_where_shared_memory_is_full(monkeypatch):
    monkeypatch.setattr(Tensor, "share_memory_", no_room)
    # PyTorch's own pickling calls it as well.
    with pytest.warns(UserWarning, match="/dev/shm has no room.*No space left.*--shm-size"):
        assert load() == [0, 1, 2]


def test_nothing_is_said_where_shared_memory_has_room():
    assert load() == load(workers=0) == [0, 1, 2]


@pytest.mark.parametrize(
    "action",
    [not_sendable, lambda: os.kill(os.getpid(), signal.SIGKILL)],
    ids=["unsendable", "killed"],
)
def test_a_worker_that_cannot_send_or_is_killed_ends_the_loading_with_an_error(action):
    with pytest.raises(ChildProcessError, match=r"set fewer --data\.init_args\.workers"):
        load(action)


def mismatched():
    torch.zeros(2) + torch.zeros(3)


@pytest.mark.parametrize("workers", [0, 2])
def test_an_error_of_pytorch_in_a_worker_is_no_lack_of_memory(workers):
    with pytest.raises(RuntimeError, match=r"The size of tensor a \(2\) must match"):
        load(mismatched, workers)


def test_a_killed_worker_is_noticed_without_its_signal(monkeypatch):
    monkeypatch.setattr(loader, "_POLL_S", 0.2)
    assert load() == [0, 1, 2]  # PyTorch sets its handler once in a process
    previous = signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    try:
        with pytest.raises(ChildProcessError, match="was ended from outside"):
            load(lambda: os.kill(os.getpid(), signal.SIGKILL))
    finally:
        signal.signal(signal.SIGCHLD, previous)


def test_a_slow_worker_is_waited_for(monkeypatch):
    monkeypatch.setattr(loader, "_POLL_S", 0.1)
    assert load(lambda: time.sleep(0.5)) == [0, 1, 2]


def test_workers_that_hang_end_the_loading_with_an_error(monkeypatch):
    monkeypatch.setattr(loader, "_BATCH_TIMEOUT_S", 0.3)
    monkeypatch.setattr(torch.utils.data._utils, "MP_STATUS_CHECK_INTERVAL", 0.1)
    with pytest.raises(ChildProcessError, match=r"no worker .* batch .*data\.init_args\.workers 0"):
        load(lambda: time.sleep(5))


@pytest.mark.parametrize(
    ("fault", "remedy"),
    [(errno.ENOSPC, "/dev/shm writable and larger"), (errno.EAGAIN, "the limit of processes")],
)
def test_workers_without_room_for_their_queues_are_told_once(monkeypatch, capfd, fault, remedy):
    def refuse(*_, **__):
        raise OSError(fault, os.strerror(fault))

    monkeypatch.setattr("multiprocessing.queues.Queue.__init__", refuse)
    with pytest.raises(ChildProcessError, match=f"cannot be started: .*{remedy}"):
        load(lambda: 1)
    gc.collect()
    assert capfd.readouterr().err == ""


def test_workers_that_cannot_be_started_end_the_loading_with_an_error(monkeypatch):
    def refuse(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(loader.DataLoader, "__iter__", refuse)
    with pytest.raises(ChildProcessError, match=r"cannot be started: no space left.*/dev/shm"):
        load()


def test_a_step_that_does_not_end_after_a_signal_is_ended(monkeypatch):
    monkeypatch.setattr(interruption, "_MAX_STEP_S", 0.1)
    note = DeferredInterruption()
    note.install()
    signal.raise_signal(signal.SIGTERM)
    with pytest.raises(Interruption) as ended:
        time.sleep(60)
    assert ended.value.exit_status == 128 + signal.SIGTERM


def test_a_run_that_is_over_leaves_no_clock_behind(monkeypatch):
    monkeypatch.setattr(interruption, "_MAX_STEP_S", 60.0)
    note = DeferredInterruption()
    note.install()
    signal.raise_signal(signal.SIGTERM)
    assert signal.getitimer(signal.ITIMER_REAL)[0] > 0
    note.restore_handlers()
    assert signal.getitimer(signal.ITIMER_REAL)[0] == 0


def test_what_follows_a_step_takes_its_time_after_a_signal():
    note = DeferredInterruption()
    note.install()
    signal.raise_signal(signal.SIGINT)
    assert signal.getitimer(signal.ITIMER_REAL)[0] > 0
    note.cancel_timeout()
    assert signal.getitimer(signal.ITIMER_REAL) == (0, 0)
    with pytest.raises(Interruption):
        note.raise_pending()

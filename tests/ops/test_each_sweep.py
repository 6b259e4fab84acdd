"""Kernels on the sweeps of a batch: each once, in one thread or several, errors kept."""

import threading

import pytest
import torch

from sightline.ops.each_sweep import for_each_sweep


@pytest.mark.parametrize("threads", [1, 3])
def test_every_sweep_is_done_once(monkeypatch, threads):
    monkeypatch.setattr(torch, "get_num_threads", lambda: threads)
    done = []
    for_each_sweep(done.append, 7)
    assert sorted(done) == list(range(7))


def test_sweeps_are_done_at_the_same_time(monkeypatch):
    monkeypatch.setattr(torch, "get_num_threads", lambda: 2)
    meeting = threading.Barrier(2, timeout=30)  # breaks if one waits for the other
    for_each_sweep(lambda _: meeting.wait(), 2)


@pytest.mark.parametrize("threads", [1, 3])
def test_an_error_of_a_sweep_is_raised(monkeypatch, threads):
    monkeypatch.setattr(torch, "get_num_threads", lambda: threads)

    def fail(sweep):
        if sweep == 2:
            raise ValueError("the third")

    with pytest.raises(ValueError, match="the third"):
        for_each_sweep(fail, 4)

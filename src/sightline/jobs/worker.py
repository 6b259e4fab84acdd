"""Limits on libraries' threads in worker processes and in forked ones."""

import os
from functools import cache

import cv2
import torch
from torch.utils.data import get_worker_info

_processes_without_threads: set[int] = set()


def keep_opencv_to_one_thread_in_workers() -> None:
    """Limit OpenCV to one thread in a worker; do nothing outside of workers.

    Work is parallel over workers: additional threads would make them wait for each other.
    """
    if get_worker_info() is not None:
        cv2.setNumThreads(0)


@cache
def keep_pytorch_to_one_thread_in_forks() -> None:
    """Limit PyTorch to one thread in every process forked from now on.

    Its threads do not survive a fork: work for them would wait for ever.
    """
    os.register_at_fork(after_in_child=_take_one_thread)


def has_lost_threads() -> bool:
    """Whether this is a forked process, in which PyTorch must use only one thread."""
    return os.getpid() in _processes_without_threads


def _take_one_thread() -> None:
    _processes_without_threads.add(os.getpid())
    torch.set_num_threads(1)

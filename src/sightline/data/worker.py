"""What threads of libraries do in worker processes and in forked ones."""

import os
from functools import cache

import cv2
import torch
from torch.utils.data import get_worker_info

_processes_without_threads: set[int] = set()


def keep_opencv_to_one_thread_in_workers() -> None:
    """Stops OpenCV from starting a thread per core in every worker; outside of one, nothing.

    The workers are the parallelism: threads on top make all of them wait for each other.
    """
    if get_worker_info() is not None:
        cv2.setNumThreads(0)


@cache
def keep_pytorch_to_one_thread_in_forks() -> None:
    """Have PyTorch take one thread in every process that is forked from now on.

    Its threads do not survive a fork: whoever hands them work there waits for ever.
    """
    os.register_at_fork(after_in_child=_take_one_thread)


def has_lost_threads() -> bool:
    """True of a forked process, in which PyTorch must not be given more than one thread."""
    return os.getpid() in _processes_without_threads


def _take_one_thread() -> None:
    _processes_without_threads.add(os.getpid())
    torch.set_num_threads(1)

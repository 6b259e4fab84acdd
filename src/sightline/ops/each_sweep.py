"""Running compiled kernels on the sweeps of a batch."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import torch


def for_each_sweep(run: Callable[[int], None], batch: int) -> None:
    """Run a kernel on every sweep of a batch, by its index, in up to PyTorch's number of threads.

    Kernels release the global interpreter lock, so the sweeps are done at the same time.
    """
    threads = min(batch, torch.get_num_threads())
    if threads < 2:
        for sweep in range(batch):
            run(sweep)
        return
    with ThreadPoolExecutor(threads) as pool:
        for _ in pool.map(run, range(batch)):  # raises what a kernel raised
            pass

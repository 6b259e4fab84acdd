"""Batch loaders with a limit on waiting for their workers."""

import errno
import io
import os
import pickle
import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing.queues import Queue
from typing import Any, Final, NoReturn

import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, Sampler

from sightline.geometry.user_warning import warn_user
from sightline.jobs.pool import holding_signals, one_blas_thread
from sightline.training.interruption import ignore_interruptions
from sightline.training.sampling import EpochPosition, TrainingBatches

_BATCH_TIMEOUT_S: Final = 1800.0
"""Time without a batch [s] after which workers count as hanging."""
_POLL_S: Final = 5.0
"""Time [s] after which the end of a worker is noticed at the latest. PyTorch's signal handler
notices it at once, but not if another handler has replaced it or a finalizer swallows its error."""
NO_WORKERS_REMEDY: Final = "set --data.init_args.workers 0"
"""Advice to `fit` where workers cannot run."""
_QUEUES: Final = 3  # beside one for each worker: for results, and room for PyTorch's events
_TIMED_OUT: Final = "DataLoader timed out"
_ENDED: Final = ("DataLoader worker (pid", "Pin memory thread")
"""Beginnings of PyTorch's errors; those of the samples' code begin with "Caught"."""
_SEND_FAILED_STATUS: Final = 3
"""Exit status of a worker that cannot send its batches to the training."""


@dataclass(frozen=True)
class FailedBatch:
    """Replacement for a batch with a sample that cannot be read or prepared."""

    reason: str


@dataclass(frozen=True)
class _PickledBatch:
    """Batch sent through a pipe, because shared memory is full."""

    content: bytes
    reason: str
    """Reason why shared memory could not be used."""


class BatchLoader(DataLoader[Any]):
    """Loader with one-sentence errors about samples, with workers or without.

    Workers send batches through shared memory (/dev/shm), or through pipes if it is full: a
    container has 64 MB of it by default.
    """

    def __init__(
        self, dataset: Dataset[Any], batches: Sampler[Any], *, workers: int, seed: int
    ) -> None:
        """Store the data set, the order of batches and the number of worker processes."""
        collate: Callable[[Any], Any] = _share_memory if workers else _identity
        super().__init__(
            dataset,
            batch_sampler=batches,
            collate_fn=collate,
            num_workers=workers,
            persistent_workers=workers > 0,
            pin_memory=torch.cuda.is_available(),
            timeout=min(_POLL_S, _BATCH_TIMEOUT_S) if workers else 0,
            worker_init_fn=_set_up_worker,
            # Otherwise the start of each epoch would draw from the global generator.
            generator=torch.Generator().manual_seed(seed),
        )

    def __iter__(self) -> Any:  # noqa: ANN401 - DataLoader promises a private class
        """Yield the batches.

        Raises:
            ValueError: A sample cannot be read or prepared.
            ChildProcessError: A worker was ended from outside, hangs, or cannot be started.
        """
        batches = self._worker_batches()
        waited_s = 0.0
        while True:
            try:
                batch = next(batches)
            except StopIteration:
                return
            except RuntimeError as error:
                waited_s += self.timeout
                is_timeout = str(error).startswith(_TIMED_OUT)
                if is_timeout and waited_s < _BATCH_TIMEOUT_S:
                    continue
                if not is_timeout and not str(error).startswith(_ENDED):
                    raise
                raise _worker_fault(is_timeout=is_timeout) from error
            waited_s = 0.0
            if isinstance(batch, FailedBatch):
                raise ValueError(batch.reason)
            yield _unpickled(batch) if isinstance(batch, _PickledBatch) else batch

    def _worker_batches(self) -> Iterator[Any]:
        """Yield the batches of the started workers."""
        if not self.num_workers:
            return super().__iter__()
        try:
            # PyTorch's iterator fails in its finalizer, too, where its queues find no room.
            queues: list[Any] = [
                torch.multiprocessing.Queue() for _ in range(self.num_workers + _QUEUES)
            ]
            queues.clear()
            with holding_signals():
                return super().__iter__()
        except OSError as error:
            remedy = (
                "raise the limit of processes (ulimit -u, or the container's)"
                if error.errno == errno.EAGAIN
                else "make /dev/shm writable and larger (docker run --shm-size 2g)"
            )
            raise ChildProcessError(
                f"the worker processes cannot be started: {(error.strerror or str(error)).lower()};"
                f" {remedy} or {NO_WORKERS_REMEDY}"
            ) from error


class ResumableLoader(BatchLoader):
    """Loader of training batches that starts at the training's current position.

    Lightning calls `load_state_dict` too late or not at all: a schedule that needs the number of
    steps creates the loader's iterator before any state is restored. So the position is read with
    the first batch. The two state methods exist because Lightning does not resume loaders without
    them.
    """

    def __init__(
        self,
        dataset: Dataset[Any],
        batches: TrainingBatches,
        position: EpochPosition,
        *,
        workers: int,
        seed: int,
    ) -> None:
        """Store the data set, the order of batches and the source of the training's position."""
        super().__init__(dataset, batches, workers=workers, seed=seed)
        self._batches = batches
        self._position = position

    def __iter__(self) -> Any:  # noqa: ANN401 - DataLoader promises a private class
        """Yield the rest of the current epoch."""
        self._batches.start_at(*self._position())
        yield from super().__iter__()

    def state_dict(self) -> dict[str, int]:
        """Next epoch and batch; for users only, no code reads it."""
        epoch, batch = self._position()
        return {"epoch": epoch, "batch": batch}

    def load_state_dict(self, state: dict[str, int]) -> None:
        """Do nothing: the position comes from the Trainer's progress."""


def _share_memory(batch: object) -> object:
    """Put a batch into shared memory where the worker can handle a failure.

    PyTorch does this in a thread of the worker; after a failure there, the training would wait
    without end.
    """
    try:
        _SharingPickler(io.BytesIO()).dump(batch)
    except (RuntimeError, OSError) as error:
        reason = re.sub(r"\s*<[^>]*>", "", str(error).strip().split("\n")[0])  # names differ
        return _PickledBatch(pickle.dumps(batch), reason=reason)
    return batch


class _SharingPickler(pickle.Pickler):
    """Pickler that moves every tensor into shared memory."""

    def persistent_id(self, obj: object) -> int | None:
        if not isinstance(obj, Tensor):
            return None
        obj.share_memory_()  # type: ignore[no-untyped-call] # PyTorch's
        return id(obj)


def _unpickled(pickled: _PickledBatch) -> object:
    warn_user(
        f"workers send batches through pipes, because /dev/shm has no room ({pickled.reason}); for "
        f"speed make it larger (docker run --shm-size 2g) or {NO_WORKERS_REMEDY}",
    )
    return pickle.loads(pickled.content)  # noqa: S301 - from our own worker


def _worker_fault(*, is_timeout: bool) -> ChildProcessError:
    """Make the error for workers that hang or are gone."""
    if is_timeout:
        return ChildProcessError(
            f"no worker process has sent a batch for {_BATCH_TIMEOUT_S:g} s; {NO_WORKERS_REMEDY}"
        )
    return ChildProcessError(
        "a worker process was ended from outside or could not send a batch; if "
        "memory or /dev/shm is full, set fewer --data.init_args.workers or "
        f"{NO_WORKERS_REMEDY}"
    )


def _identity(batch: object) -> object:
    return batch


def _set_up_worker(worker: int) -> None:
    """Leave signals to the Trainer; limit the worker to one BLAS thread."""
    del worker
    ignore_interruptions()
    one_blas_thread()
    # Only in this process. Python's handler prints a traceback and lets the training wait.
    Queue._on_queue_feeder_error = staticmethod(_end_worker)  # type: ignore[attr-defined] # noqa: SLF001


def _end_worker(error: Exception, obj: object) -> NoReturn:
    """End the worker if a batch cannot be sent; the training detects its end."""
    del obj
    reason = " ".join(str(error).split()) or type(error).__name__
    print(f"sightline: a worker cannot send a batch: {reason}", file=sys.stderr, flush=True)
    os._exit(_SEND_FAILED_STATUS)

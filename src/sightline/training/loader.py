"""Loaders of batches whose workers never let a training wait for ever."""

import io
import os
import pickle
import re
import sys
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing.queues import Queue
from typing import Any, Final, NoReturn

import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, Sampler

from sightline.data.parallel import holding_signals, one_blas_thread
from sightline.training.interruption import leave_interruption_to_the_parent
from sightline.training.sampling import EpochPosition, TrainingBatches

_LONGEST_BATCH_S: Final = 1800.0
"""Time without a batch after which workers count as hanging."""
_NO_WORKERS: Final = "set --data.init_args.workers 0"
_CANNOT_HAND_ON: Final = 3
"""Exit status of a worker whose batches do not reach the training."""


@dataclass(frozen=True)
class Unusable:
    """Comes in place of a batch that cannot be made."""

    reason: str


@dataclass(frozen=True)
class _Parcel:
    """A batch that goes through a pipe, as shared memory has no room for it."""

    content: bytes
    lacking: str
    """Why shared memory could not be used."""


class BatchLoader(DataLoader[Any]):
    """A loader that says in one sentence what is wrong with a sample, with workers or without.

    Workers hand batches on through shared memory (/dev/shm), and through pipes where that is full:
    a container has 64 MB of it unless it is started with more.
    """

    def __init__(
        self, dataset: Dataset[Any], batches: Sampler[Any], *, workers: int, seed: int
    ) -> None:
        """Takes what to load, in which order, by how many processes besides this one."""
        collate: Callable[[Any], Any] = _handed_on if workers else _as_it_is
        super().__init__(
            dataset,
            batch_sampler=batches,
            collate_fn=collate,
            num_workers=workers,
            persistent_workers=workers > 0,
            pin_memory=torch.cuda.is_available(),
            timeout=_LONGEST_BATCH_S if workers else 0,
            worker_init_fn=_set_up_worker,
            # Else each epoch's start would draw from the global generator.
            generator=torch.Generator().manual_seed(seed),
        )

    def __iter__(self) -> Any:  # noqa: ANN401 - DataLoader promises a private class
        """The batches.

        Raises:
            ValueError: A sample cannot be read or prepared.
            ChildProcessError: A worker was ended from outside, hangs, or cannot be started.
        """
        batches = self._started()
        while True:
            try:
                batch = next(batches)
            except StopIteration:
                return
            except RuntimeError as error:
                raise _worker_fault(error) or error from error
            if isinstance(batch, Unusable):
                raise ValueError(batch.reason)
            yield _unpacked(batch) if isinstance(batch, _Parcel) else batch

    def _started(self) -> Iterator[Any]:
        """The batches, of workers that have been started."""
        if not self.num_workers:
            return super().__iter__()
        try:
            with holding_signals():
                return super().__iter__()
        except OSError as error:
            raise ChildProcessError(
                f"the worker processes cannot be started: {(error.strerror or str(error)).lower()};"
                f" make /dev/shm writable and larger (docker run --shm-size 2g) or {_NO_WORKERS}"
            ) from error


class ResumableLoader(BatchLoader):
    """A loader of training batches that starts at the training's current position.

    Lightning's own way, `load_state_dict`, comes too late or not at all: a schedule that asks for
    the number of steps has the loader's iterator made before any state is restored. So the
    position is asked for when the first batch is; the two methods are there because Lightning takes
    a loader without them for one that cannot resume.
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
        """Takes what to load, in which order, and who knows how far the training is."""
        super().__init__(dataset, batches, workers=workers, seed=seed)
        self._batches = batches
        self._position = position

    def __iter__(self) -> Any:  # noqa: ANN401 - DataLoader promises a private class
        """The rest of the epoch that the training is in."""
        self._batches.start_at(*self._position())
        yield from super().__iter__()

    def state_dict(self) -> dict[str, int]:
        """Epoch and batch that come next; for people, nothing is read from it."""
        epoch, batch = self._position()
        return {"epoch": epoch, "batch": batch}

    def load_state_dict(self, state: dict[str, int]) -> None:
        """Does nothing: the Trainer's own progress tells the position."""


def _handed_on(batch: object) -> object:
    """Put a batch into shared memory while its worker can still do something about a failure.

    PyTorch does so in a thread of the worker, whose failure leaves the training waiting.
    """
    try:
        _SharingPickler(io.BytesIO()).dump(batch)
    except (RuntimeError, OSError) as error:
        lacking = re.sub(r"\s*<[^>]*>", "", str(error).strip().split("\n")[0])  # names differ
        return _Parcel(pickle.dumps(batch), lacking=lacking)
    return batch


class _SharingPickler(pickle.Pickler):
    """Moves every tensor of what it pickles into shared memory."""

    def persistent_id(self, obj: object) -> int | None:
        if not isinstance(obj, Tensor):
            return None
        obj.share_memory_()  # type: ignore[no-untyped-call] # PyTorch's
        return id(obj)


def _unpacked(parcel: _Parcel) -> object:
    warnings.warn(
        f"batches come from the workers through pipes, as /dev/shm has no room ({parcel.lacking}); "
        f"it is faster with more (docker run --shm-size 2g); without workers: {_NO_WORKERS}",
        stacklevel=2,
    )
    return pickle.loads(parcel.content)  # noqa: S301 - from our own worker


def _worker_fault(error: RuntimeError) -> ChildProcessError | None:
    """What to say of workers that are gone or hang; None where the error is another one."""
    if "DataLoader timed out" in str(error):
        return ChildProcessError(
            f"no worker process has given a batch for {_LONGEST_BATCH_S:g} s; {_NO_WORKERS}"
        )
    if "DataLoader worker" in str(error) or "Pin memory thread" in str(error):
        return ChildProcessError(
            "a worker process was ended from outside or could not hand a batch on; where memory "
            f"or /dev/shm ran out, set fewer data.workers or {_NO_WORKERS}"
        )
    return None


def _as_it_is(batch: object) -> object:
    return batch


def _set_up_worker(worker: int) -> None:
    """Leaves signals to the Trainer, and the cores to the other workers."""
    del worker
    leave_interruption_to_the_parent()
    one_blas_thread()
    # Of this process alone. Python's own prints a traceback and lets the training wait.
    Queue._on_queue_feeder_error = staticmethod(_end_worker)  # type: ignore[attr-defined] # noqa: SLF001


def _end_worker(error: Exception, obj: object) -> NoReturn:
    """End the worker, which the training sees; called where a batch cannot be sent."""
    del obj
    reason = " ".join(str(error).split()) or type(error).__name__
    print(f"sightline: a worker cannot hand a batch on: {reason}", file=sys.stderr, flush=True)
    os._exit(_CANNOT_HAND_ON)

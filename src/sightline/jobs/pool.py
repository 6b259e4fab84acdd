"""Pool of processes for jobs of many independent pieces."""

import contextlib
import multiprocessing
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from types import FrameType
from typing import Any, Final, NamedTuple

from threadpoolctl import threadpool_limits

Piece = Callable[[int], str]
"""Function that runs piece N of a job; returns the error, empty: none."""

one_blas_thread = partial(threadpool_limits, limits=1, user_api="blas")
"""Limits numpy's matrix products to one thread, permanently or as a context: the matrices here are
too small for several, and waiting threads occupy the cores of other workers."""

_PATIENCE_S: Final = 5.0
"""Time for workers to finish their current pieces when the job is stopped."""
_MAX_PIECE_S: Final = 3600.0
"""Time without any result after which workers count as hanging."""
_POLL_S: Final = 5.0
_SIGNAL_S: Final = 0.2
"""Time between signals to the processes of a job, for example from a batch system."""
_HELD_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGALRM)


@contextmanager
def holding_signals() -> Iterator[None]:
    """Delay Ctrl-C, SIGTERM, SIGHUP and SIGALRM until the block ends, for the start of processes.

    Python drops exceptions of signal handlers within hooks of `os.fork`, which libraries have: the
    job would continue. A child starts with handlers that do nothing; see `ignore_interrupts`.
    Outside the main thread, the only one that gets signals, this does nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    received: list[int] = []

    def record(number: int, frame: FrameType | None) -> None:
        del frame
        received.append(number)

    previous: dict[int, Any] = {}
    try:
        for number in _HELD_SIGNALS:
            if signal.getsignal(number) is not None:  # None: not Python's, so it raises nothing
                previous[number] = signal.signal(number, record)
        yield
    finally:
        for held, handler in previous.items():
            signal.signal(held, handler)
        for pending in dict.fromkeys(received):
            signal.raise_signal(pending)


def ignore_interrupts() -> None:
    """Ignore Ctrl-C and SIGHUP in a worker: terminals send them to every process of a job."""
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    for number in (signal.SIGTERM, signal.SIGALRM):
        signal.signal(number, signal.SIG_DFL)


def run_pieces(piece: Piece, count: int, workers: int) -> Iterator[str]:
    """Runs pieces 0 to `count` - 1 of a job and yields their return values, in order.

    A piece returns its error instead of raising it: an exception in a worker becomes a RuntimeError
    with a traceback. Pieces write files atomically, so that a job stopped by Ctrl-C, for example,
    leaves only complete files.

    Args:
        piece: Function of a piece; must be picklable on systems that spawn workers (macOS,
            Windows).
        count: Number of pieces.
        workers: Number of worker processes; 1: only this process.

    Raises:
        ChildProcessError: A worker was ended from outside, such as for lack of memory, none could
            be started, or there was no result for an hour.
    """
    if workers == 1:
        with one_blas_thread():
            yield from map(piece, range(count))
        return
    pool = _Pool(piece)
    try:
        pool.start(min(workers, count))
        yield from pool.run(count)
    finally:
        pool.close()


class _Outcome(NamedTuple):
    """Result of a worker."""

    result: str
    fault: str
    """Traceback, if the piece raised an error."""


class _Pool:
    """Pool of workers that run one piece at a time.

    Not `concurrent.futures`: its workers print a traceback each after Ctrl-C and outlive a killed
    parent. Not PyTorch's `DataLoader`: PyTorch needs half a gigabyte per worker, and many jobs do
    not need it.
    """

    def __init__(self, piece: Piece) -> None:
        self._piece = piece
        self._processes: dict[Connection, BaseProcess] = {}
        self._doing: dict[Connection, int] = {}

    def start(self, workers: int) -> None:
        """Start the processes."""
        for _ in range(workers):
            try:
                with holding_signals():
                    self._start_one()
            except OSError as error:
                raise ChildProcessError(
                    f"a worker process cannot be started: {(error.strerror or str(error)).lower()}"
                    "; use fewer workers"
                ) from error

    def _start_one(self) -> None:
        own_end, worker_end = multiprocessing.Pipe()
        process = multiprocessing.Process(target=_work, args=(self._piece, worker_end), daemon=True)
        process.start()
        worker_end.close()
        self._processes[own_end] = process

    def run(self, count: int) -> Iterator[str]:
        """Runs the pieces and yields their return values, in order."""
        waiting = iter(range(count))
        done: dict[int, str] = {}
        for channel in self._processes:
            self._hand_out(channel, waiting)
        for position in range(count):
            while position not in done:
                ready = self._ready()
                for channel in [channel for channel in self._doing if channel in ready]:
                    done[self._doing[channel]] = self._take_back(channel)
                    self._hand_out(channel, waiting)
            yield done.pop(position)

    def _ready(self) -> set[object]:
        """Channels of workers that have a result or have ended."""
        # Counted in short waits, so that the time of a suspended job does not count.
        for _ in range(int(_MAX_PIECE_S / _POLL_S)):
            ready: set[object] = set(wait(self._doing, timeout=_POLL_S))
            if ready:
                return ready
        pieces = ", ".join(map(str, sorted(self._doing.values())))
        raise ChildProcessError(
            f"no worker process has given a result for {_MAX_PIECE_S:g} s (at pieces {pieces})"
            "; use 1 worker"
        )

    def close(self) -> None:
        """Lets every worker finish its piece and ends it, by force if necessary."""
        for channel in self._processes:
            with contextlib.suppress(OSError):  # it has ended already
                channel.send(None)
        deadline_s = time.monotonic() + _PATIENCE_S  # one deadline for all workers
        processes = list(self._processes.values())
        for process in processes:
            process.join(max(deadline_s - time.monotonic(), 0))
        for process in processes:  # signals all before waiting: they end in parallel
            process.terminate()
        deadline_s = time.monotonic() + _POLL_S
        for process in processes:
            process.join(max(deadline_s - time.monotonic(), 0))
            if process.is_alive():
                process.kill()

    def _hand_out(self, channel: Connection, waiting: Iterator[int]) -> None:
        self._doing.pop(channel, None)
        position = next(waiting, None)
        if position is not None:
            self._doing[channel] = position
            with contextlib.suppress(OSError):  # it has ended, which is detected later
                channel.send(position)

    def _take_back(self, channel: Connection) -> str:
        try:
            outcome = _Outcome(*channel.recv())
        except (EOFError, OSError):
            time.sleep(_SIGNAL_S)  # a signal that ended every process of the job ends this one
            raise ChildProcessError(
                "a worker process was ended from outside; where memory ran out, use fewer workers"
            ) from None
        if outcome.fault:
            raise RuntimeError(f"piece {self._doing[channel]} of the job failed:\n{outcome.fault}")
        return outcome.result


def _work(piece: Piece, channel: Connection) -> None:
    """Run the pieces whose numbers come through the channel, until None or the end of the parent.

    The parent ends its workers between two pieces. Work is parallel over workers: additional
    threads would make them wait for each other.
    """
    import cv2  # here, because the command line imports this module and must start fast

    ignore_interrupts()
    with contextlib.suppress(EOFError, OSError):  # the parent informs the user
        cv2.setNumThreads(0)
        one_blas_thread()
        if "torch" in sys.modules:
            sys.modules["torch"].set_num_threads(1)
        parent = multiprocessing.parent_process()
        assert parent is not None, "a worker has a parent"
        while parent.sentinel not in wait([channel, parent.sentinel]):
            position = channel.recv()
            if position is None:
                return
            channel.send(tuple(_outcome(piece, position)))


def _outcome(piece: Piece, position: int) -> _Outcome:
    try:
        return _Outcome(piece(position), "")
    except BaseException:  # noqa: BLE001 - the parent raises it; some libraries' are no Exception
        return _Outcome("", traceback.format_exc())

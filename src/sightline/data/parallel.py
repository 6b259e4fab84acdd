"""A pool of processes for jobs of many independent pieces."""

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
"""Does piece N of a job; returns the error, empty if there is none."""

one_blas_thread = partial(threadpool_limits, limits=1, user_api="blas")
"""Keeps numpy's matrix products to one thread, for good or as a context: the matrices here are too
small to share, and waiting helpers take the cores from the other workers."""

_PATIENCE_S: Final = 5.0
"""What workers may take for the pieces that they are at when the job is stopped."""
_LONGEST_PIECE_S: Final = 3600.0
"""Time without any result after which workers count as hanging."""
_LOOK_EVERY_S: Final = 5.0
_HELD_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGALRM)


@contextmanager
def holding_signals() -> Iterator[None]:
    """Delay Ctrl-C, SIGTERM and SIGALRM until the block ends, for the start of processes.

    Python drops an exception that a signal's handler raises within `os.fork`, where libraries have
    hooks: the job would run on. A child starts with handlers that do nothing; see
    `ignore_interrupts`. Outside the main thread, which alone gets signals, this does nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    noted: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        del frame
        noted.append(number)

    previous: dict[int, Any] = {}
    try:
        for number in _HELD_SIGNALS:
            if signal.getsignal(number) is not None:  # None: not Python's, so it raises nothing
                previous[number] = signal.signal(number, note)
        yield
    finally:
        for held, handler in previous.items():
            signal.signal(held, handler)
        for came in dict.fromkeys(noted):
            signal.raise_signal(came)


def ignore_interrupts() -> None:
    """Leave Ctrl-C, which a terminal sends to every process, to the parent of this worker."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for number in (signal.SIGTERM, signal.SIGALRM):
        signal.signal(number, signal.SIG_DFL)


def run_pieces(piece: Piece, count: int, workers: int) -> Iterator[str]:
    """Does pieces 0 to `count` - 1 of a job and gives what each returns, in order.

    A piece returns its error instead of raising it: what it raises comes back from a worker as a
    RuntimeError that holds a traceback. It writes a file aside and renames it, so that a job which
    is stopped, by Ctrl-C for one, leaves whole files only.

    Args:
        piece: Picklable where workers are started afresh (macOS, Windows).
        count: Number of pieces.
        workers: Processes that work; 1 is this process alone.

    Raises:
        ChildProcessError: A worker was ended from outside, for want of memory for one, none
            could be started, or for an hour none has given a result.
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
    """What comes back from a worker."""

    result: str
    fault: str
    """Traceback, where the piece raised an error."""


class _Pool:
    """Workers, each of which does a piece at a time.

    Not `concurrent.futures`, whose workers answer Ctrl-C with a traceback each and outlive a
    parent that is killed, and not PyTorch's `DataLoader`: PyTorch alone takes half a gigabyte of a
    worker, and not every job needs it.
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
        ours, theirs = multiprocessing.Pipe()
        process = multiprocessing.Process(target=_work, args=(self._piece, theirs), daemon=True)
        process.start()
        theirs.close()
        self._processes[ours] = process

    def run(self, count: int) -> Iterator[str]:
        """Does the pieces and gives what they return, in order."""
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
        """The channels of workers that have a result or have ended."""
        # Counted in short waits: a job that the user suspends does not age meanwhile.
        for _ in range(int(_LONGEST_PIECE_S / _LOOK_EVERY_S)):
            ready: set[object] = set(wait(self._doing, timeout=_LOOK_EVERY_S))
            if ready:
                return ready
        pieces = ", ".join(map(str, sorted(self._doing.values())))
        raise ChildProcessError(
            f"no worker process has given a result for {_LONGEST_PIECE_S:g} s (at pieces {pieces})"
            "; use 1 worker"
        )

    def close(self) -> None:
        """Lets every worker finish its piece and ends it, by force where it does not."""
        for channel in self._processes:
            with contextlib.suppress(OSError):  # it has ended already
                channel.send(None)
        deadline_s = time.monotonic() + _PATIENCE_S  # one for all, however many are slow
        processes = list(self._processes.values())
        for process in processes:
            process.join(max(deadline_s - time.monotonic(), 0))
        for process in processes:  # all before the first is waited for: they end side by side
            process.terminate()
        deadline_s = time.monotonic() + _LOOK_EVERY_S
        for process in processes:
            process.join(max(deadline_s - time.monotonic(), 0))
            if process.is_alive():
                process.kill()

    def _hand_out(self, channel: Connection, waiting: Iterator[int]) -> None:
        self._doing.pop(channel, None)
        position = next(waiting, None)
        if position is not None:
            self._doing[channel] = position
            with contextlib.suppress(OSError):  # it has ended, as is seen when it is asked
                channel.send(position)

    def _take_back(self, channel: Connection) -> str:
        try:
            outcome = _Outcome(*channel.recv())
        except (EOFError, OSError):
            raise ChildProcessError(
                "a worker process was ended from outside; where memory ran out, use fewer workers"
            ) from None
        if outcome.fault:
            raise RuntimeError(f"piece {self._doing[channel]} of the job failed:\n{outcome.fault}")
        return outcome.result


def _work(piece: Piece, channel: Connection) -> None:
    """Does the pieces whose numbers come through the channel, until None comes or nobody is left.

    The parent ends its workers between two pieces. The workers are the parallelism: threads on top
    would make all of them wait for each other.
    """
    import cv2  # here: the command line checks outputs by this package, and starts without it

    ignore_interrupts()
    with contextlib.suppress(EOFError, OSError):  # the parent tells the user
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

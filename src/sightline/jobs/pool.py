"""Processes of this machine as workers of a job, and their signals and threads."""

import contextlib
import itertools
import multiprocessing
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from types import FrameType
from typing import Any, Final

from threadpoolctl import threadpool_limits

from sightline.jobs.crew import Piece, Report, report_of

one_blas_thread = partial(threadpool_limits, limits=1, user_api="blas")
"""Limits numpy's matrix products to one thread, permanently or as a context: the matrices here are
too small for several, and waiting threads occupy the cores of other workers."""

_PATIENCE_S: Final = 5.0
"""Time for workers to finish their current pieces when the job is stopped."""
_LAST_S: Final = 5.0
"""Time for workers to end after the request."""
_SIGNAL_S: Final = 0.2
"""Time between signals to the processes of a job, for example from a batch system."""
HELD_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGALRM)
"""Signals by which programs are interrupted."""


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
        for number in HELD_SIGNALS:
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


class ProcessCrew:
    """Worker processes of this machine.

    Not `concurrent.futures`: its workers print a traceback each after Ctrl-C and outlive a killed
    parent. Not PyTorch's `DataLoader`: PyTorch needs half a gigabyte per worker, and many jobs do
    not need it.
    """

    def __init__(self, piece: Piece) -> None:
        self._piece = piece
        self._processes: dict[int, tuple[Connection, BaseProcess]] = {}
        self._numbers = itertools.count()

    def hire(self) -> int:
        """Start a process."""
        try:
            with holding_signals():
                return self._start()
        except OSError as error:
            raise ChildProcessError(
                f"a worker process cannot be started: {(error.strerror or str(error)).lower()}"
                "; use fewer workers"
            ) from error

    def _start(self) -> int:
        own_end, worker_end = multiprocessing.Pipe()
        process = multiprocessing.Process(target=_work, args=(self._piece, worker_end), daemon=True)
        process.start()
        worker_end.close()
        number = next(self._numbers)
        self._processes[number] = own_end, process
        return number

    def hand(self, worker: int, position: int) -> None:
        """Send a process the number of its next piece."""
        with contextlib.suppress(OSError):  # it has ended, which is detected later
            self._processes[worker][0].send(position)

    def reports(self, timeout_s: float) -> dict[int, Report]:
        """Read the results of processes, and note those that have ended."""
        numbers = {channel: number for number, (channel, _) in self._processes.items()}
        ready = [each for each in wait(numbers, timeout_s) if isinstance(each, Connection)]
        return {numbers[channel]: self._report(numbers[channel]) for channel in ready}

    def _report(self, worker: int) -> Report:
        channel, process = self._processes[worker]
        try:
            return Report(*channel.recv())
        except (EOFError, OSError):
            time.sleep(_SIGNAL_S)  # a signal that ended every process of the job ends this one
            process.join(_SIGNAL_S)
            self.dismiss(worker)
            return Report(ended=_cause(process.exitcode or 0))

    def dismiss(self, worker: int) -> None:
        """Kill a process."""
        channel, process = self._processes.pop(worker)
        process.kill()
        process.join()
        channel.close()

    def close(self) -> None:
        """Let every worker finish its piece, and end it, by force if necessary."""
        for channel, _ in self._processes.values():
            with contextlib.suppress(OSError):  # it has ended already
                channel.send(None)
        deadline_s = time.monotonic() + _PATIENCE_S  # one deadline for all workers
        processes = [process for _, process in self._processes.values()]
        for process in processes:
            process.join(max(deadline_s - time.monotonic(), 0))
        for process in processes:  # signals all before waiting: they end in parallel
            process.terminate()
        deadline_s = time.monotonic() + _LAST_S
        for process in processes:
            process.join(max(deadline_s - time.monotonic(), 0))
            if process.is_alive():
                process.kill()


def _cause(exit_code: int) -> str:
    """Describe the end of a process."""
    if exit_code >= 0:
        return f"ended by itself with status {exit_code}"
    return f"was ended from outside by signal {-exit_code}"


def take_one_thread() -> None:
    """Limit the libraries of a worker to one thread.

    Work is parallel over workers: additional threads would make them wait for each other.
    Progress bars inside libraries get a lock of this process: their own is a semaphore of the
    system, which a killed worker would leave behind, with a warning at the program's end.
    """
    import cv2  # here, because the command line imports this module and must start fast

    cv2.setNumThreads(0)
    one_blas_thread()
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)
    if "tqdm" in sys.modules:
        sys.modules["tqdm"].tqdm.set_lock(threading.RLock())


def _work(piece: Piece, channel: Connection) -> None:
    """Run the pieces whose numbers come through the channel, until None or the end of the parent.

    The parent ends its workers between two pieces.
    """
    ignore_interrupts()
    with contextlib.suppress(EOFError, OSError):  # the parent informs the user
        take_one_thread()
        parent = multiprocessing.parent_process()
        assert parent is not None, "a worker has a parent"
        channel.send(tuple(Report()))
        while parent.sentinel not in wait([channel, parent.sentinel]):
            position = channel.recv()
            if position is None:
                return
            channel.send(tuple(report_of(piece, position)))

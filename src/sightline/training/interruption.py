"""Interruption by Ctrl-C, SIGTERM (batch systems) or SIGHUP (closed terminals)."""

import multiprocessing
import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any, Final


class Interruption(KeyboardInterrupt):
    """A run that was ended from outside; the message explains how to resume it."""

    def __init__(self, message: str, number: int) -> None:
        """Store the message and the number of the signal."""
        super().__init__(message)
        self.number = number

    @property
    def exit_status(self) -> int:
        """Exit status of a program that was ended by the signal, as shells report it."""
        return 128 + self.number


SIGNALS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that end a command."""


_WORKER_TIMEOUT_S: Final = 1.0
"""Time for a worker to end after a signal."""

_MAX_STEP_S: Final = 25.0
"""Longest duration of a step after the signal; batch systems kill after 30 s."""


def interrupt(number: int, frame: FrameType | None = None) -> None:
    """End the current work at once; a signal handler."""
    del frame
    raise Interruption("", number)


@contextmanager
def ending_by_signals() -> Iterator[None]:
    """Let SIGTERM and SIGHUP end the block as Ctrl-C does; restore all handlers afterwards.

    Handlers of the caller stay, and so does SIGHUP being ignored.
    """
    previous: dict[int, Any] = {number: signal.getsignal(number) for number in SIGNALS}
    for number, handler in previous.items():
        if handler == signal.SIG_DFL:
            signal.signal(number, interrupt)
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


@contextmanager
def terminating_workers() -> Iterator[None]:
    """Terminate the worker processes that the block started, if it ends by an exception.

    Workers ignore their first SIGTERM. Without this one, Python's exit would send the first and
    then wait for them without a limit.
    """
    before = set(multiprocessing.active_children())
    try:
        yield
    except BaseException:
        with suppress(RuntimeError):  # raised by PyTorch if a worker ends by the signal
            left = set(multiprocessing.active_children()) - before
            for worker in left:
                worker.terminate()
            for worker in left:
                worker.join(_WORKER_TIMEOUT_S)
        raise


class DeferredInterruption:
    """Deferral of the first signal to the end of the current step; a second one ends it at once.

    A step that takes longer than batch systems wait, such as a hanging one, is ended too.
    """

    def __init__(self) -> None:
        """Start without a pending signal and without handlers."""
        self.number: int | None = None
        self._previous: dict[int, Any] = {}

    def install(self) -> None:
        """Install the signal handlers."""
        if not self._previous:
            is_kept = signal.getsignal(signal.SIGHUP) == signal.SIG_IGN  # by nohup
            numbers = [number for number in SIGNALS if number != signal.SIGHUP or not is_kept]
            self._previous = {number: signal.signal(number, self._defer) for number in numbers}

    def restore_handlers(self) -> None:
        """Restore the previous signal handlers and the unlimited duration of steps."""
        for number, handler in self._previous.items():
            signal.signal(number, handler)
        self._previous = {}
        self.cancel_timeout()

    def cancel_timeout(self) -> None:
        """Remove the time limit, for the writing of a checkpoint after the step."""
        if self.number is not None:
            signal.setitimer(signal.ITIMER_REAL, 0)

    def raise_pending(self) -> None:
        """End the current work if a signal is pending.

        Raises:
            Interruption: A signal is pending.
        """
        self.cancel_timeout()
        if self.number is not None:
            interrupt(self.number)

    def _defer(self, number: int, frame: FrameType | None) -> None:
        del frame
        self.number = number
        self.restore_handlers()
        signal.signal(signal.SIGALRM, lambda *_: interrupt(number))
        signal.setitimer(signal.ITIMER_REAL, _MAX_STEP_S)


def ignore_interruptions() -> None:
    """Ignore interruptions in a worker process: they reach every process of a job.

    Without its workers the parent could not finish its step. A second SIGTERM comes from the
    parent, for a worker that did not end on request.
    """

    def pass_over_first(number: int, frame: FrameType | None) -> None:
        del frame
        signal.signal(number, signal.SIG_DFL)

    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, pass_over_first)

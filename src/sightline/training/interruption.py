"""Ctrl-C and SIGTERM, which batch systems send: a run ends between two steps, for both alike."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, Final


class Interruption(KeyboardInterrupt):
    """A run that was ended from outside; the message tells how to go on."""

    def __init__(self, message: str, number: int) -> None:
        """Takes the message and the number of the signal."""
        super().__init__(message)
        self.number = number

    @property
    def exit_status(self) -> int:
        """What a shell reports for a program that the signal ended."""
        return 128 + self.number


SIGNALS = (signal.SIGINT, signal.SIGTERM)
"""What ends a run."""


_LONGEST_STEP_S: Final = 25.0
"""What a step may still take when the run is to end; batch systems kill after 30 s."""


def interrupt(number: int, frame: FrameType | None = None) -> None:
    """Ends the current work at once; a signal handler."""
    del frame
    raise Interruption("", number)


@contextmanager
def ending_like_ctrl_c() -> Iterator[None]:
    """Lets SIGTERM end the block as Ctrl-C does, and leaves both as they were before."""
    previous: dict[int, Any] = {number: signal.getsignal(number) for number in SIGNALS}
    signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


class InterruptionNote:
    """Notes the first of the signals, so that a step can end; a second one ends it at once.

    A step that goes on for longer than batch systems wait before they kill, as it hangs say, is
    ended, too.
    """

    def __init__(self) -> None:
        """Has noted nothing, and is not listening yet."""
        self.number: int | None = None
        self._previous: dict[int, Any] = {}

    def listen(self) -> None:
        """Takes over the signals."""
        if not self._previous:
            self._previous = {number: signal.signal(number, self._note) for number in SIGNALS}

    def give_back(self) -> None:
        """Leaves the signals to whom they were before, and ends no step any more."""
        for number, handler in self._previous.items():
            signal.signal(number, handler)
        self._previous = {}
        self.stop_waiting()

    def stop_waiting(self) -> None:
        """Lets what follows the step, the writing of a checkpoint, take its time."""
        if self.number is not None:
            signal.setitimer(signal.ITIMER_REAL, 0)

    def raise_noted(self) -> None:
        """Ends the current work if a signal has been noted.

        Raises:
            Interruption: One has.
        """
        self.stop_waiting()
        if self.number is not None:
            interrupt(self.number)

    def _note(self, number: int, frame: FrameType | None) -> None:
        del frame
        self.number = number
        self.give_back()
        signal.signal(signal.SIGALRM, lambda *_: interrupt(number))
        signal.setitimer(signal.ITIMER_REAL, _LONGEST_STEP_S)


def leave_interruption_to_the_parent() -> None:
    """For worker processes: Ctrl-C and a batch system's SIGTERM reach every process of a job.

    Without its workers the parent could not finish its step. A second SIGTERM is the parent's own,
    to a worker that did not end when it was told to.
    """

    def overhear(number: int, frame: FrameType | None) -> None:
        del frame
        signal.signal(number, signal.SIG_DFL)

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, overhear)

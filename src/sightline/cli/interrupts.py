"""Ctrl-C while libraries are being imported."""

import signal
from types import FrameType

_RETRY_S = 0.05


def postpone_interrupts_while_importing() -> None:
    """Lets Ctrl-C wait until no import is under way; for the main thread of a program.

    A `KeyboardInterrupt` in the middle of an import is not passed on by all compiled libraries:
    some end the process with a core dump, others turn it into errors that say nothing.
    """
    signal.signal(signal.SIGINT, _interrupt)
    signal.signal(signal.SIGALRM, _interrupt)


def _interrupt(signal_number: int, frame: FrameType | None) -> None:
    del signal_number
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            signal.setitimer(signal.ITIMER_REAL, _RETRY_S)
            return
        frame = frame.f_back
    raise KeyboardInterrupt

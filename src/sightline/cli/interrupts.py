"""Ctrl-C, and SIGTERM for trainings, while libraries are being imported."""

import signal
from collections.abc import Sequence
from types import FrameType
from typing import get_args

from sightline.training.interruption import interrupt

_RETRY_S = 0.05


def postpone_interrupts_while_importing(arguments: Sequence[str]) -> None:
    """Lets Ctrl-C wait until no import is under way; for the main thread of a program.

    A `KeyboardInterrupt` in the middle of an import is not passed on by all compiled libraries:
    some end the process with a core dump, others turn it into errors that say nothing.

    Args:
        arguments: Of the command line. SIGTERM ends a training as Ctrl-C does.
    """
    signal.signal(signal.SIGINT, _interrupt)
    from sightline.training.arguments import Subcommand  # takes a moment, in which Ctrl-C may come

    if arguments and arguments[0] in get_args(Subcommand):
        signal.signal(signal.SIGTERM, _interrupt)


def _interrupt(number: int, frame: FrameType | None) -> None:
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            signal.signal(signal.SIGALRM, lambda _, later: _interrupt(number, later))
            signal.setitimer(signal.ITIMER_REAL, _RETRY_S)
            return
        frame = frame.f_back
    if number == signal.SIGTERM:
        interrupt(number)
    raise KeyboardInterrupt

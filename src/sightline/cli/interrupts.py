"""Ctrl-C, and SIGTERM for trainings, where an exception would be lost: in imports and forks."""

import os
import signal
import sys
from collections.abc import Callable, Sequence
from functools import partial
from types import FrameType
from typing import TYPE_CHECKING, get_args

from sightline.training.interruption import interrupt

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

_RETRY_S = 0.05


def keep_interrupts(arguments: Sequence[str]) -> None:
    """Repeat Ctrl-C until it ends the command; for the main thread of a program.

    A `KeyboardInterrupt` in the middle of an import is not passed on by all compiled libraries:
    some end the process with a core dump, others turn it into errors that say nothing. So it waits
    until no import is under way. Python itself drops one in finalizers and in hooks of `os.fork`,
    after which the job would run on: so it comes again a moment later.

    Args:
        arguments: Of the command line. SIGTERM ends a training as Ctrl-C does.
    """
    signal.signal(signal.SIGINT, _interrupt)
    sys.unraisablehook = partial(_repeat_dropped, sys.unraisablehook, os.getpid())
    from sightline.training.arguments import Subcommand  # takes a moment, in which Ctrl-C may come

    if arguments and arguments[0] in get_args(Subcommand):
        signal.signal(signal.SIGTERM, _interrupt)


def _interrupt(number: int, frame: FrameType | None) -> None:
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            _repeat(number)
            return
        frame = frame.f_back
    if number == signal.SIGTERM:
        interrupt(number)
    raise KeyboardInterrupt


def _repeat(number: int) -> None:
    """Interrupt a moment later."""
    signal.signal(signal.SIGALRM, lambda _, later: _interrupt(number, later))
    signal.setitimer(signal.ITIMER_REAL, _RETRY_S)


def _repeat_dropped(
    report: "Callable[[UnraisableHookArgs], object]", process: int, dropped: "UnraisableHookArgs"
) -> None:
    """Repeat an interruption that Python has dropped; report any other exception as before."""
    if not issubclass(dropped.exc_type, KeyboardInterrupt):
        report(dropped)
    elif os.getpid() == process:  # a forked worker leaves it to its parent
        _repeat(getattr(dropped.exc_value, "number", signal.SIGINT))

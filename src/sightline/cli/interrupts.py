"""Handling of Ctrl-C, and SIGTERM in trainings, if imports or forks would lose the exception."""

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

    Some compiled libraries do not pass on a `KeyboardInterrupt` during their import: they crash
    with a core dump or raise unclear errors. So it waits for the end of imports. Python itself
    drops it in finalizers and in hooks of `os.fork`, and the job would continue: so it is repeated
    a moment later.

    Args:
        arguments: Arguments of the command line. SIGTERM ends a training as Ctrl-C does.
    """
    signal.signal(signal.SIGINT, _interrupt)
    sys.unraisablehook = partial(_repeat_dropped, sys.unraisablehook, os.getpid())
    from sightline.training.arguments import Subcommand  # slow; Ctrl-C may come meanwhile

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
    """Schedule an interruption a moment later."""
    signal.signal(signal.SIGALRM, lambda _, later: _interrupt(number, later))
    signal.setitimer(signal.ITIMER_REAL, _RETRY_S)


def _repeat_dropped(
    report: "Callable[[UnraisableHookArgs], object]", process: int, dropped: "UnraisableHookArgs"
) -> None:
    """Repeat an interruption dropped by Python; report other exceptions as before."""
    if not issubclass(dropped.exc_type, KeyboardInterrupt):
        report(dropped)
    elif os.getpid() == process:  # in a forked worker, the parent handles it
        _repeat(getattr(dropped.exc_value, "number", signal.SIGINT))

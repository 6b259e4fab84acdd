"""Handling of Ctrl-C, SIGTERM and SIGHUP where imports or forks would lose the exception."""

import atexit
import contextlib
import logging
import math
import os
import signal
import sys
import time
from collections.abc import Callable
from functools import partial
from types import FrameType
from typing import TYPE_CHECKING, Final

from sightline.training.interruption import SIGNALS, interrupt

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

HOW_TO_FINISH: Final = "interrupted; run the same command again to finish"

_raised: list[int] = []
_RETRY_S: Final = 0.05
_LONGEST_IMPORT_S: Final = 3.0
"""Time for an import to finish after the signal; that of PyTorch takes long on a busy machine."""


def keep_interrupts() -> None:
    """Let Ctrl-C, SIGTERM and SIGHUP end the command; for the main thread of a program.

    Some compiled libraries do not pass on a `KeyboardInterrupt` during their import: they crash
    with a core dump or raise unclear errors. So it waits for the end of imports, for a while.
    Python itself drops it in finalizers and in hooks of `os.fork`, and the job would continue: so
    it is repeated a moment later. SIGHUP stays ignored for programs started by `nohup`.
    """
    interrupter = _Interrupter()
    for number in SIGNALS:
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, interrupter)
    # An alarm during Python's end would kill it, as there is no handler by then.
    atexit.register(signal.setitimer, signal.ITIMER_REAL, 0)
    sys.unraisablehook = partial(interrupter.repeat_dropped, sys.unraisablehook, os.getpid())


def raised_signal() -> int | None:
    """Number of the first signal that has ended the command; None: none has.

    Compiled libraries turn the exception into an error of their own, such as a damaged file's.
    """
    return _raised[0] if _raised else None


class _Interrupter:
    """Signal handler that raises an `Interruption` outside imports, or ends a long import."""

    def __init__(self) -> None:
        self._deadline_s = math.inf

    def __call__(self, number: int, frame: FrameType | None) -> None:
        if _is_importing(frame):
            self._deadline_s = min(self._deadline_s, time.monotonic() + _LONGEST_IMPORT_S)
            if time.monotonic() >= self._deadline_s:
                _leave(number)
            self._repeat(number)
            return
        self._deadline_s = math.inf
        _raised.append(number)
        logging.getLogger("asyncio").disabled = True  # it would list requests that end by this
        interrupt(number)

    def repeat_dropped(
        self,
        report: "Callable[[UnraisableHookArgs], object]",
        process: int,
        dropped: "UnraisableHookArgs",
    ) -> None:
        """Repeat an interruption dropped by Python; report other exceptions as before."""
        if not issubclass(dropped.exc_type, KeyboardInterrupt):
            report(dropped)
        elif os.getpid() == process:  # in a forked worker, the parent handles it
            self._repeat(getattr(dropped.exc_value, "number", signal.SIGINT))

    def _repeat(self, number: int) -> None:
        """Schedule an interruption a moment later, by whatever then handles the signal.

        That is this handler, or one of a library that has taken over, such as a server's.
        """
        signal.signal(signal.SIGALRM, lambda *_: signal.raise_signal(number))
        signal.setitimer(signal.ITIMER_REAL, _RETRY_S)


def _is_importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


def _leave(number: int) -> None:
    """Exit without cleaning up: workers end with their parent, files are written atomically."""
    with contextlib.suppress(OSError):
        os.write(2, f"sightline: {HOW_TO_FINISH}\n".encode())
    os._exit(128 + number)

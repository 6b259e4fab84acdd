"""Warning of a low limit of processes, by which libraries fail with misleading messages."""

import contextlib
import os
import resource
import sys
import threading
from pathlib import Path
from typing import Final

from sightline.geometry.user_warning import warn_user

_LOW_LIMIT: Final = 1024  # a higher one is not tried out
_OTHERS: Final = 16  # threads beside those of the libraries' pools, one pool for each core
_POOLS: Final = 4
_CONTAINER_LIMIT: Final = Path("/sys/fs/cgroup/pids.max")


def warn_of_few_threads() -> None:
    """Warn if a low limit leaves fewer threads than libraries start.

    Some end the process without an exception then, or by Ctrl-C's signal.
    """
    if _limit() > _LOW_LIMIT:
        return
    needed = _OTHERS + _POOLS * (os.cpu_count() or 1)
    startable = _startable_threads(needed)
    if startable < needed:
        warn_user(
            f"only {startable} further threads can be started, about {needed} are needed: "
            "libraries may fail or end the program; raise the limit of processes (ulimit -u, or "
            "the container's)",
        )


def _limit() -> int:
    """Lower one of the limits of the user and of the container."""
    user, _ = resource.getrlimit(resource.RLIMIT_NPROC)
    limits = [] if user == resource.RLIM_INFINITY else [user]
    with contextlib.suppress(OSError, ValueError):  # without a limit the file says "max"
        limits.append(int(_CONTAINER_LIMIT.read_text()))
    return min(limits, default=sys.maxsize)


def _startable_threads(wanted: int) -> int:
    """Number of threads that can run at the same time, up to those wanted."""
    end = threading.Event()
    threads = []
    try:
        for _ in range(wanted):
            thread = threading.Thread(target=end.wait, daemon=True)
            thread.start()
            threads.append(thread)
    except RuntimeError:
        pass
    finally:
        end.set()
    for thread in threads:
        thread.join()
    return len(threads)

"""Compilation of this project's kernels by numba."""

import inspect
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba.core.caching import FunctionCache

from sightline.ops.cache_folder import cache_folder

_numba_settings: Any = numba.config  # its attributes are made at run time

Kernel = TypeVar("Kernel", bound=Callable[..., Any])


def compiled(kernel: Kernel) -> Kernel:
    """Compile a function of numbers and numpy arrays to machine code, cached on disk between runs.

    The cache is in NUMBA_CACHE_DIR if set, else in the package's own __pycache__, or in
    `cache_folder` if that is not writable. Without such a place, or without space, each process
    compiles again.

    The global interpreter lock is released while it runs. A division by zero gives infinity or NaN
    as numpy's does: raising an error would need a branch for each division, which prevents
    vectorised loops.

    Under pytest, jaxtyping's import hook wraps every function of the project in a shape check,
    which numba cannot compile. So the check is removed first, and shapes are checked in the
    function that calls the kernel.
    """
    function = inspect.unwrap(kernel)
    dispatcher: Any = numba.njit(nogil=True, error_model="numpy")(function)
    place = _place(Path(inspect.getfile(function)).parent)
    if place is not None:
        given, _numba_settings.CACHE_DIR = _numba_settings.CACHE_DIR, place
        try:
            cache = _Cache(function)  # type: ignore[no-untyped-call] # numba's
            dispatcher._cache = cache  # noqa: SLF001 - as its enable_caching does
        except (RuntimeError, OSError):  # numba finds no place, or no source text
            pass
        finally:
            _numba_settings.CACHE_DIR = given
    return cast("Kernel", dispatcher)


def _place(package: Path) -> str | None:
    """Folder for numba: empty for the package's own; None for no folder."""
    if _numba_settings.CACHE_DIR:
        return str(_numba_settings.CACHE_DIR)
    own = package / "__pycache__"
    if os.access(own if own.exists() else package, os.W_OK | os.X_OK):
        return ""
    kept = cache_folder()
    return None if kept is None else str(kept / "kernels")


class _Cache(FunctionCache):
    """Cache that disables itself if its files are damaged or cannot be written."""

    @contextmanager
    def _guard_against_spurious_io_errors(self) -> Iterator[None]:
        try:
            yield
        except Exception:  # noqa: BLE001 - a disk error, or anything from a damaged pickle
            self.disable()  # type: ignore[no-untyped-call] # numba's

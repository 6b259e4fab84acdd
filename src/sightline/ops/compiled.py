"""How numba compiles the kernels of this project."""

import inspect
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

Kernel = TypeVar("Kernel", bound=Callable[..., Any])


def compiled(kernel: Kernel) -> Kernel:
    """Compiles a function of numbers and numpy arrays to machine code, kept on disk between runs.

    The global interpreter lock is released while it runs. A division by zero gives infinity or NaN
    as numpy's does: to raise an error instead, each division would need a branch, which keeps
    loops from being vectorised.

    Under pytest, jaxtyping's import hook wraps every function of the project in a shape check,
    which numba cannot compile: the check is taken off first, so shapes are checked in the function
    that calls the kernel.
    """
    return cast(
        "Kernel", numba.njit(cache=True, nogil=True, error_model="numpy")(inspect.unwrap(kernel))
    )

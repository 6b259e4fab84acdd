"""Reused memory for large results on a CPU.

The system provides memory empty, page by page. For a result of 80 MB this takes as long as filling
it, so the last such block is kept, up to 256 MB, like in GPU allocators.
"""

import weakref
from collections import deque
from typing import Final

import numpy as np
from jaxtyping import Shaped
from numpy import ndarray

_MIN_BYTES: Final = 2**22  # smaller results use memory that the process already has
_MAX_BYTES: Final = 2**28
# A much larger block is not used: the result would keep all of it allocated.
_MAX_SIZE_RATIO: Final = 4
_spare: Final[deque[Shaped[ndarray, " num_bytes"]]] = deque(maxlen=1)


def rows_to_fill(
    num_rows: int, num_columns: int, dtype: np.dtype
) -> Shaped[ndarray, "{num_rows} {num_columns}"]:
    """Make an uninitialised array; every value of it must be written.

    Its memory is reused once the array, and everything that shares its memory, is deleted.
    """
    num_bytes = num_rows * num_columns * dtype.itemsize
    if not _MIN_BYTES <= num_bytes <= _MAX_BYTES:
        return np.empty((num_rows, num_columns), dtype)
    block = _take_spare()
    if block is not None and block.nbytes > _MAX_SIZE_RATIO * num_bytes:
        _keep(block)
        block = None
    if block is None or block.nbytes < num_bytes:
        block = np.empty(num_bytes, np.uint8)  # numpy requests large pages, torch does not
    # Over a buffer: views keep the buffer alive, where views of a view would keep the block alive.
    flat = np.frombuffer(block.data, dtype, num_rows * num_columns)
    weakref.finalize(flat, _keep, block).atexit = False
    return flat.reshape(num_rows, num_columns)


def _take_spare() -> Shaped[ndarray, " num_bytes"] | None:
    try:
        return _spare.pop()
    except IndexError:  # try instead of a check: another thread may be faster
        return None


def _keep(block: Shaped[ndarray, " num_bytes"]) -> None:
    """Keep the larger of two blocks."""
    other = _take_spare()
    _spare.append(block if other is None or other.nbytes < block.nbytes else other)

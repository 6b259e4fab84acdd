"""Conversion of users' arrays, tensors and nested lists."""

from collections.abc import Sequence
from contextlib import suppress
from typing import Any, SupportsIndex

import numpy as np
import torch
from jaxtyping import Float64, Int64, Shaped
from torch import Tensor, bfloat16, strided

from sightline.geometry.arguments import short_repr
from sightline.geometry.plain_arrays import plain_array
from sightline.geometry.user_warning import warn_user

Given = np.ndarray | Tensor | Sequence[Any]
"""Array, tensor or nested lists of numbers."""
Rows = SupportsIndex | slice | Sequence[SupportsIndex] | np.ndarray | Tensor
"""Choice of rows: a number, numbers, a slice, or a mask of bool."""


def given_array(name: str, given: object) -> Shaped[np.ndarray, "..."]:
    """Convert an array, a tensor or nested lists to an array; memory may be shared.

    Args:
        name: Name in error messages.
        given: Value of any type and shape.

    Raises:
        ValueError: Values are masked, a tensor has none (those on the device meta), or rows have
            several lengths; or a Pillow image has other colours than RGB.
    """
    return _tensor_array(name, given) if isinstance(given, Tensor) else plain_array(name, given)


def plain_numbers(name: str, given: object) -> Float64[np.ndarray, "..."]:
    """Convert an array, a tensor or nested lists of any shape to float64.

    Raises:
        ValueError: The value contains something else than numbers.
    """
    array = given_array(name, given)
    if array.dtype.kind in "fiuOU":
        with suppress(TypeError, ValueError):
            return array.astype(np.float64)
    raise ValueError(f"{name} is {short_repr(given)}, expected numbers; give rows of numbers")


def selected_rows(chosen: Rows, num_rows: int) -> Int64[Tensor, " num_chosen"]:
    """Convert a choice of rows to their numbers: a number, numbers, a slice, or a mask of bool.

    Raises:
        ValueError: It is none of these, or a mask of another length.
        IndexError: There is no row of a number.
    """
    if isinstance(chosen, slice):
        return torch.tensor(range(num_rows)[chosen], dtype=torch.int64)
    given = _tensor_of_rows(chosen)
    if given is None or given.ndim > 1 or isinstance(chosen, tuple):
        raise ValueError(
            f"rows are chosen by {short_repr(chosen)}, expected a whole number, a list or a tensor "
            "of them, a slice, or a mask of bool"
        )
    if given.dtype == torch.bool:
        if given.shape != (num_rows,):
            raise ValueError(
                f"the mask has {given.numel()} values, expected {num_rows}, one for each row"
            )
        return given.nonzero()[:, 0]
    rows = given.long().reshape(-1)
    if rows.device.type == "cpu":  # a GPU would have to wait for the answer
        is_absent = (rows >= num_rows) | (rows < -num_rows)
        if is_absent.any():
            absent = int(rows[is_absent][0])
            raise IndexError(f"there is no row {absent}: there are {num_rows}, from 0")
    return rows


def _tensor_of_rows(chosen: object) -> Tensor | None:
    """Convert a choice of rows to a tensor of bool or whole numbers; None: it is something else.

    Arrays of uint8 are refused: they may be masks, as of old.
    """
    if not isinstance(chosen, Tensor):
        array = given_array("rows", chosen)
        is_old_mask = array.dtype == np.uint8 and array.ndim > 0
        if array.size and (array.dtype.kind not in "biu" or is_old_mask):  # [] is of floats
            return None
        return torch.from_numpy(np.array(array, np.bool_ if array.dtype.kind == "b" else np.int64))
    is_old_mask = chosen.dtype == torch.uint8 and chosen.ndim > 0
    return None if is_old_mask or chosen.is_floating_point() or chosen.is_complex() else chosen


def _tensor_array(name: str, tensor: Tensor) -> Shaped[np.ndarray, "..."]:
    if tensor.is_meta:
        raise ValueError(
            f"{name} is a tensor on the device meta, which has no values; give a tensor on the CPU "
            "or a GPU"
        )
    dense = tensor if tensor.layout == strided else tensor.to_dense()
    if dense.dtype == bfloat16 and not name.endswith("image"):  # whose levels it holds exactly
        warn_user(
            f"{name} are bfloat16, which rounds 60 m to steps of 0.25 m; give float32",
        )
    wide = dense.float() if dense.dtype == bfloat16 else dense  # NumPy has no bfloat16
    try:
        array: Shaped[np.ndarray, "..."] = wide.numpy(force=True)
    except TypeError:
        raise ValueError(
            f"{name} is a tensor of {wide.dtype}, which NumPy has no type for; give "
            f"tensor.{'dequantize' if wide.is_quantized else 'float'}()"
        ) from None
    return array

"""Conversion of users' arrays, tensors and nested lists."""

import warnings
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import numpy as np
from jaxtyping import Float64, Shaped
from torch import Tensor, bfloat16, strided

from sightline.geometry.arguments import short_repr
from sightline.geometry.plain_arrays import plain_array

Given = np.ndarray | Tensor | Sequence[Any]
"""Array, tensor or nested lists of numbers."""


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


def _tensor_array(name: str, tensor: Tensor) -> Shaped[np.ndarray, "..."]:
    if tensor.is_meta:
        raise ValueError(
            f"{name} is a tensor on the device meta, which has no values; give a tensor on the CPU "
            "or a GPU"
        )
    dense = tensor if tensor.layout == strided else tensor.to_dense()
    if dense.dtype == bfloat16 and not name.endswith("image"):  # whose levels it holds exactly
        warnings.warn(
            f"{name} are bfloat16, which rounds 60 m to steps of 0.25 m; give float32",
            stacklevel=3,
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

"""Conversion of users' arrays, tensors and nested lists."""

import warnings
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, Final

import numpy as np
from jaxtyping import Float64, Shaped
from torch import Tensor, bfloat16, strided

from sightline.geometry.arguments import short_repr

Given = np.ndarray | Tensor | Sequence[Any]
"""Array, tensor or nested lists of numbers."""


# Modes of Pillow's images whose numbers are no levels of grey, red, green and blue.
_OTHER_MODES: Final = frozenset(
    ("1", "P", "PA", "LA", "La", "RGBA", "RGBa", "RGBX", "CMYK", "YCbCr", "HSV", "LAB")
)


def given_array(name: str, given: object) -> Shaped[np.ndarray, "..."]:
    """Convert an array, a tensor or nested lists to an array; memory may be shared.

    Args:
        name: Name in error messages.
        given: Value of any type and shape.

    Raises:
        ValueError: Values are masked, a tensor has none (those on the device meta), or rows have
            several lengths; or a Pillow image has other colours than RGB.
    """
    if isinstance(given, np.ma.MaskedArray):
        masked = int(np.ma.getmaskarray(given).sum())
        if masked:
            raise ValueError(
                f"{name} has {masked} of {given.size} values masked, and their data are undefined; "
                "fill them: array.filled(..)"
            )
        return np.asarray(given.data)
    if isinstance(given, Tensor):
        return _tensor_array(name, given)
    mode = getattr(given, "mode", "RGB") if hasattr(given, "getbands") else "RGB"  # Pillow's
    if mode in _OTHER_MODES:
        raise ValueError(
            f"{name} is a Pillow image of mode {mode}, expected RGB; give image.convert('RGB')"
        )
    try:
        return np.asarray(given)
    except ValueError as error:  # rows of different lengths
        raise ValueError(
            f"{name} is {short_repr(given)}, expected an array; give rows of one length"
        ) from error


def shaped_array(
    name: str, given: object, shape: tuple[int | None, ...], kinds: str, expected: str
) -> Shaped[np.ndarray, "..."]:
    """Convert an array, a tensor or nested lists, and check shape and type.

    Args:
        name: Name in error messages.
        given: Value of any type and shape.
        shape: Expected lengths; None: any.
        kinds: Letters of the expected types (`dtype.kind`), such as "fiu" for numbers.
        expected: Description of shape and type, and the remedy, for errors.

    Raises:
        ValueError: The value has another shape or type, or none (`given_array`).
    """
    array = given_array(name, given)
    is_shaped = array.ndim == len(shape) and all(
        wanted in (None, length) for wanted, length in zip(shape, array.shape, strict=True)
    )
    if is_shaped and array.dtype.kind in kinds:
        return array
    raise ValueError(f"{name} is {array.dtype} of shape {array.shape}, expected {expected}")


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


def without_masked(given: object, fill: float = np.nan) -> object:
    """Fill masked numbers, which become float64; return anything else unchanged."""
    if not isinstance(given, np.ma.MaskedArray) or given.dtype.kind not in "fiu":
        return given
    is_masked = np.ma.getmaskarray(given)
    return np.where(is_masked, fill, given.data) if is_masked.any() else given


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

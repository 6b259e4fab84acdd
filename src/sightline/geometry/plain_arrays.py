"""Conversion of users' arrays without PyTorch, which workers that write files do not load."""

from typing import Final

import numpy as np
from jaxtyping import Shaped

from sightline.geometry.arguments import short_repr

# Modes of Pillow's images whose numbers are no levels of grey, red, green and blue.
_OTHER_MODES: Final = frozenset(
    ("1", "P", "PA", "LA", "La", "RGBA", "RGBa", "RGBX", "CMYK", "YCbCr", "HSV", "LAB")
)


def plain_array(name: str, given: object) -> Shaped[np.ndarray, "..."]:
    """Convert an array or nested lists to an array; memory may be shared.

    Args:
        name: Name in error messages.
        given: Value of any type and shape.

    Raises:
        ValueError: Values are masked, rows have several lengths, or a Pillow image has other
            colours than RGB.
    """
    if isinstance(given, np.ma.MaskedArray):
        masked = int(np.ma.getmaskarray(given).sum())
        if masked:
            raise ValueError(
                f"{name} has {masked} of {given.size} values masked, and their data are undefined; "
                "fill them: array.filled(..)"
            )
        return np.asarray(given.data)
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
        ValueError: The value has another shape or type, or none (`plain_array`).
    """
    to_numpy = getattr(given, "numpy", None)  # of a tensor
    array = plain_array(name, given if to_numpy is None else to_numpy(force=True))
    is_shaped = array.ndim == len(shape) and all(
        wanted in (None, length) for wanted, length in zip(shape, array.shape, strict=True)
    )
    if is_shaped and array.dtype.kind in kinds:
        return array
    raise ValueError(f"{name} is {array.dtype} of shape {array.shape}, expected {expected}")


def without_masked(given: object, fill: float = np.nan) -> object:
    """Fill masked numbers, which become float64; return anything else unchanged."""
    if not isinstance(given, np.ma.MaskedArray) or given.dtype.kind not in "fiu":
        return given
    is_masked = np.ma.getmaskarray(given)
    return np.where(is_masked, fill, given.data) if is_masked.any() else given

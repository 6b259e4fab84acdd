"""Checks of settings' numbers: weights files and recipes may come from anywhere."""

import math
from collections.abc import Callable, Collection, Mapping, Sized
from typing import Final

MAX_NUMBERS: Final = 2**29
"""Largest number of values in a layer's output for one sweep: 2 GB."""

_RULES: Final[Mapping[str, Callable[[float], bool]]] = {
    "from 0 to 1": lambda value: 0 <= value <= 1,
    "above 0 and at most 1": lambda value: 0 < value <= 1,
    "positive and finite": lambda value: 0 < value < math.inf,
    "finite and not negative": lambda value: 0 <= value < math.inf,
    "at least 0": lambda value: value >= 0,
    "at least 1": lambda value: value >= 1,
}


def check_numbers(settings: object, rule: str, *names: str, within: str = "") -> None:
    """Check numbers, or tuples of numbers, of a dataclass of settings by one of `_RULES`.

    Raises:
        ValueError: A number breaks the rule; the message names it after `within`.
    """
    for name in names:
        value = getattr(settings, name)
        if not all(map(_RULES[rule], value if isinstance(value, tuple) else (value,))):
            raise ValueError(f"{within}{name} must be {rule}, got {value}")


def check_different(name: str, values: Sized, keys: Collection[str]) -> None:
    """Check that there is at least one value, and that no two have the same key.

    Raises:
        ValueError: There is none, or two are the same.
    """
    if not keys or len(set(keys)) < len(keys):
        raise ValueError(f"{name} must hold one or more different ones, got {values}")


def check_widths(name: str, widths: tuple[int, ...]) -> None:
    """Check the output channels of one or more layers.

    Raises:
        ValueError: There is no layer, or one without channels.
    """
    if not widths or min(widths) < 1:
        raise ValueError(f"{name} must hold one positive width a layer, got {widths}")

"""Ranges of settings, declared on the fields of a dataclass and checked by one function."""

import math
from collections.abc import Mapping
from functools import cache
from typing import Annotated, Any, NamedTuple, SupportsFloat, get_args, get_origin, get_type_hints

from sightline.geometry.arguments import wrong_type

Number = float | int


class Within(NamedTuple):
    """Limits of a number, or of the two numbers of a range, the lower first.

    It annotates a field: `share: Annotated[float, Within(0, 1)] = 0.5`. A tuple of more than two
    numbers, such as a colour, has each number within the limits.
    """

    lowest: Number
    highest: Number = math.inf


def check_ranges(settings: object) -> None:
    """Check every field of a dataclass that is annotated with `Within`; for its `__post_init__`.

    Raises:
        ValueError: A number is not finite, or not within its limits, or a range is empty.
        TypeError: A value is no number, or no tuple of numbers.
    """
    kind: Any = type(settings)  # of no protocol, as mypy denies that classes can be hashed
    for name, limits in _field_limits(kind).items():
        value = getattr(settings, name)
        try:
            _check_value(name, value, limits)
        except TypeError:
            raise wrong_type(name, value, "a number or a tuple of numbers") from None


def _check_value(name: str, value: Any, limits: Within) -> None:  # noqa: ANN401 - users' settings
    if not isinstance(value, tuple):
        _check_number(name, value, *limits)
    elif len(value) == 2:
        _check_pair(name, value, *limits)
    else:
        for each in value:
            _check_number(f"each number of {name}", each, *limits)


@cache
def _field_limits(kind: type[Any]) -> Mapping[str, Within]:
    hints = get_type_hints(kind, include_extras=True)
    return {
        name: limits
        for name, hint in hints.items()
        if get_origin(hint) is Annotated
        for limits in get_args(hint)[1:]
        if isinstance(limits, Within)
    }


def check_range(
    name: str, value: SupportsFloat, lowest: SupportsFloat, highest: SupportsFloat
) -> None:
    """Check that a number is within limits that only a `__post_init__` knows; NaN is not.

    Raises:
        ValueError: It is not.
    """
    low, high = float(lowest), float(highest)
    if not low <= float(value) <= high:
        raise ValueError(f"{name} must be from {low:.9g} to {high:.9g}, got {value}")


def _check_pair(name: str, bounds: tuple[Number, Number], lowest: Number, highest: Number) -> None:
    """Check a range for random draws: it must not be empty or exceed the limits."""
    if not (lowest <= bounds[0] <= bounds[1] <= highest and bounds[1] < math.inf):
        raise ValueError(
            f"{name} must be two numbers from {lowest:g} to {highest:g}, the lower first; got "
            f"{bounds[0]:g} and {bounds[1]:g}"
        )


def _check_number(name: str, value: Number, lowest: Number, highest: Number) -> None:
    """Check that a setting is finite and within the limits."""
    if not (lowest <= value <= highest and value < math.inf):
        limits = f"from {lowest:g} to {highest:g}" if highest < math.inf else f"at least {lowest:g}"
        raise ValueError(f"{name} must be finite and {limits}, got {value:g}")

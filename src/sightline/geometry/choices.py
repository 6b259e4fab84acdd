"""Checks of choices (`Literal`) and switches (`bool`): arguments of functions, fields of settings.

Without PyTorch, for commands that start at once.
"""

import types
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from functools import cache
from itertools import chain
from numbers import Real
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from sightline.geometry.arguments import nearest, short_repr, wrong_type


def check_choices(settings: object, prefix: str = "") -> None:
    """Check the choices and switches among a dataclass's fields.

    Args:
        settings: The dataclass.
        prefix: Text before a field's name in messages, such as `trunk.`.

    Raises:
        ValueError: A text or number is none of its field's choices.
        TypeError: A value is of another type.
    """
    kind: Any = type(settings)  # mypy denies that classes can be hashed
    for name, choices in choices_in(kind).items():
        check_choice(f"{prefix}{name}", getattr(settings, name), choices)


def check_choice(name: str, value: object, choices: Collection[object]) -> None:
    """Check that a value is one of the choices; 0 and 1 count as False and True.

    Raises:
        ValueError: A text or number is none of them.
        TypeError: The value is of another type.
    """
    if value is None or isinstance(value, str | Real | np.bool_):
        if value in choices:
            return
        others = [choice for choice in choices if not isinstance(choice, bool | None)]
        if value is not None and any(isinstance(value, str) == isinstance(c, str) for c in others):
            valid = ", ".join(map(str, choices))
            texts = [choice for choice in others if isinstance(choice, str)]
            meant = nearest(value, texts).removesuffix("; ") if isinstance(value, str) else ""
            hint = f"; {meant}" if meant else ""
            raise ValueError(f"{name} must be one of {valid}, got {short_repr(value)}{hint}")
    raise wrong_type(name, value, " or ".join(map(repr, choices)))


@cache
def choices_in(annotated: Callable[..., object]) -> Mapping[str, tuple[object, ...]]:
    """Collect the choices of a function's parameters or a dataclass's fields, by name."""
    hints = {name: hint for name, hint in hints_of(annotated).items() if name != "return"}
    return {name: values for name, hint in hints.items() if (values := _values(hint))}


def hints_of(annotated: Callable[..., object]) -> dict[str, Any]:
    """Read type hints; those that name imports for type checkers alone stay text."""
    with suppress(NameError):
        return get_type_hints(annotated)
    return dict(annotated.__annotations__)


def _values(hint: object) -> tuple[object, ...]:
    """List the values of `Literal`, `bool` and their unions with None; empty for other hints."""
    if get_origin(hint) in (Union, types.UnionType):
        parts = [_values(part) for part in get_args(hint)]
        return tuple(chain(*parts)) if all(parts) else ()
    if get_origin(hint) is Literal:
        return get_args(hint)
    if hint is types.NoneType:
        return (None,)
    return (True, False) if hint is bool else ()

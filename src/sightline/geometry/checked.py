"""Dataclasses that check types and shapes of their fields, with error messages of one line."""

import re
from collections.abc import Callable
from dataclasses import fields
from functools import wraps
from inspect import isfunction
from typing import Any, TypeVar

import numpy as np
from beartype import BeartypeConf, beartype
from jaxtyping import TypeCheckError, jaxtyped
from torch import Tensor

from sightline.geometry.wrong_types import named_arguments

Class = TypeVar("Class", bound=type[Any])

# Whole numbers count as floats, as in Python's own type checkers.
_WIDE = BeartypeConf(is_pep484_tower=True)

_FAULT = re.compile(
    r"typechecking parameter '(?P<field>\w+)'.*?\nActual value: (?P<value>.*?)"
    r"\nExpected type: (?P<expected>.*?)\.\n",
    re.DOTALL,
)
_MAX_VALUE_LENGTH = 80  # characters of a wrong value


def checked(*, wide: bool = False, remedy: str = "convert it") -> Callable[[Class], Class]:
    """Make a dataclass reject fields of other types or shapes, with a TypeError of one line.

    Its public methods name arguments of a wrong type (`named_arguments`), and `==` compares fields,
    arrays by their values.

    Args:
        wide: Whether to accept a whole number where a float is expected.
        remedy: Advice in the message for a wrong field.
    """

    def decorate(kind: Class) -> Class:
        typechecker = beartype(conf=_WIDE) if wide else beartype
        made: Class = jaxtyped(kind, typechecker=typechecker)
        build = made.__init__

        @wraps(build)
        def init(self: object, *args: object, **fields: object) -> None:
            try:
                build(self, *args, **fields)
            except TypeCheckError as error:
                raise TypeCheckError(_in_one_line(kind.__name__, str(error), remedy)) from None

        # mypy rejects plain assignments to these
        setattr(made, "__init__", init)  # noqa: B010
        if "__eq__" in vars(kind):
            setattr(made, "__eq__", _are_equal)  # noqa: B010
            setattr(made, "__hash__", _hash_fields)  # noqa: B010
        for name, method in list(vars(made).items()):
            if name.startswith("_"):
                continue
            if isinstance(method, classmethod):
                setattr(made, name, classmethod(named_arguments(method.__func__)))
            elif isfunction(method):
                setattr(made, name, named_arguments(method))
        return made

    return decorate


def _are_equal(one: Any, other: Any) -> Any:  # noqa: ANN401 - dataclasses, and a Boolean
    """Compare two dataclasses of one type field by field; arrays by shape, type and values.

    NaN, of what is unknown, equals NaN at the same place.
    """
    if type(other) is not type(one):
        return NotImplemented
    shared: Any = one  # mypy narrows it to object
    return all(_is_same(getattr(one, f.name), getattr(other, f.name)) for f in fields(shared))


def _is_same(value: object, other: object) -> bool:
    if isinstance(value, Tensor) and isinstance(other, Tensor):
        alike = value.dtype == other.dtype and value.device == other.device
        alike = alike and value.shape == other.shape
        return alike and bool(((value == other) | (value.isnan() & other.isnan())).all())
    if isinstance(value, np.ndarray) and isinstance(other, np.ndarray):
        has_nan = value.dtype.kind in "fc"
        return value.dtype == other.dtype and np.array_equal(value, other, equal_nan=has_nan)
    if isinstance(value, tuple) and isinstance(other, tuple):
        return len(value) == len(other) and all(map(_is_same, value, other))
    return bool(value == other)


def _hash_fields(one: Any) -> int:  # noqa: ANN401 - a dataclass
    """Hash all fields except arrays, so that equal dataclasses have equal hashes."""
    return hash((type(one), *(_key(getattr(one, field.name)) for field in fields(one))))


def _key(value: object) -> object:
    if isinstance(value, tuple):
        return tuple(map(_key, value))
    return None if isinstance(value, Tensor | np.ndarray) else value


def _in_one_line(name: str, message: str, remedy: str) -> str:
    fault = _FAULT.search(message)
    if fault is None:
        return " ".join(message.split())
    value = " ".join(fault["value"].split())
    value = value if len(value) <= _MAX_VALUE_LENGTH else f"{value[:_MAX_VALUE_LENGTH]}.."
    expected = re.sub(r"<class '(.*?)'>(?= \||$)", r"\1", fault["expected"])
    expected = re.sub(r"\b(jaxtyping|sightline|torch)\.([a-z_0-9]+\.)*", "", expected)
    return f"{name} takes {fault['field']} as {expected}, got {value}; {remedy}"

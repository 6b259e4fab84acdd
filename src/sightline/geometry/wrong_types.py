"""Errors of calls that fail because an argument is of a wrong type.

Without PyTorch, for commands that start at once.
"""

import inspect
import re
import types
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import wraps
from numbers import Real
from typing import Any, Literal, ParamSpec, TypeVar, Union, get_args, get_origin, get_type_hints

from sightline.geometry.arguments import wrong_type

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")

_TYPE_ERRORS = (TypeError, AttributeError)
"""Errors that Python or a library raises for a value of another type."""


def named_arguments(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """Decorate a function so that its errors name an argument of a wrong type.

    Arguments are examined only after a failure: other types that work stay valid, at no cost.
    The error is a TypeError of one line with the argument, its type and the expected one.
    """
    if inspect.isgeneratorfunction(function):
        return _named_in_generator(function)

    @wraps(function)
    def call(*args: Parameters.args, **named: Parameters.kwargs) -> Result:
        try:
            return function(*args, **named)
        except _TYPE_ERRORS as error:
            fault = _fault(error, function, args, named)
            if fault is None:
                raise
            raise fault from error

    return call


def _named_in_generator(function: Callable[Parameters, Any]) -> Callable[Parameters, Any]:
    """Decorate a generator function likewise; it fails at its first item."""

    @wraps(function)
    def items(*args: Parameters.args, **named: Parameters.kwargs) -> Iterator[object]:
        try:
            yield from function(*args, **named)
        except _TYPE_ERRORS as error:
            fault = _fault(error, function, args, named)
            if fault is None:
                raise
            raise fault from error

    return items


def _fault(
    error: Exception,
    function: Callable[..., object],
    args: tuple[object, ...],
    named: dict[str, Any],
) -> TypeError | None:
    """Find the first argument of another type than annotated.

    None if there is none, or if the error names it already.
    """
    if type(error) not in _TYPE_ERRORS or " is of type " in str(error):
        return None
    with suppress(TypeError):  # a missing argument, or one too many
        given = inspect.signature(function).bind(*args, **named).arguments
        hints = function.__annotations__
        with suppress(NameError):  # of names for type checkers alone
            hints = get_type_hints(function)
        for name, value in given.items():
            hint = hints.get(name)
            if hint is not None and not isinstance(hint, str) and not _matches_hint(value, hint):
                called = function.__qualname__.removesuffix(".__init__")
                return wrong_type(f"{called}: {name}", value, _expected(hint))
    return None


def _matches_hint(value: object, hint: Any) -> bool:  # noqa: ANN401 - a type hint
    """Check the type of a value; numbers of any library count as Python's."""
    from beartype.door import is_bearable

    try:
        if is_bearable(value, hint):
            return True
        is_number = isinstance(value, Real) and not isinstance(value, bool)
        return is_number and (is_bearable(1.0, hint) or is_bearable(1, hint))
    except Exception:  # noqa: BLE001 - a hint that cannot be checked names no fault
        return True


def _expected(hint: Any) -> str:  # noqa: ANN401 - a type hint
    """Format a type hint without modules."""
    if get_origin(hint) in (Union, types.UnionType):
        return " or ".join(_expected(each) for each in get_args(hint))
    if get_origin(hint) is Literal:
        return "one of " + ", ".join(map(str, get_args(hint)))
    if hint is types.NoneType:
        return "None"
    text = hint.__name__ if isinstance(hint, type) and not get_args(hint) else str(hint)
    return re.sub(r"\b[a-z_]\w*\.", "", text)

"""Errors of calls with an argument of a wrong type, or that is none of its choices.

Without PyTorch, for commands that start at once.
"""

import inspect
import re
import types
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import wraps
from numbers import Real
from typing import Any, Literal, ParamSpec, TypeVar, Union, get_args, get_origin

from sightline.geometry.arguments import wrong_type
from sightline.geometry.choices import check_choice, choices_in, hints_of

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")

_TYPE_ERRORS = (TypeError, AttributeError)
"""Errors that Python or a library raises for a value of another type."""


def named_arguments(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """Decorate a function so that its errors name an argument of a wrong type.

    Other types are examined only after a failure: those that work stay valid, at no cost. The error
    is a TypeError of one line with the argument, its type and the expected one. Choices (`Literal`)
    and switches (`bool`) are checked before the call: a misspelt one, or the text "no", would
    silently be taken for another.
    """
    if inspect.isgeneratorfunction(function):
        return _named_in_generator(function)

    @wraps(function)
    def call(*args: Parameters.args, **named: Parameters.kwargs) -> Result:
        _check_choices(function, args, named)
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
        _check_choices(function, args, named)
        try:
            yield from function(*args, **named)
        except _TYPE_ERRORS as error:
            fault = _fault(error, function, args, named)
            if fault is None:
                raise
            raise fault from error

    return items


def _check_choices(
    function: Callable[..., object], args: tuple[object, ...], named: dict[str, Any]
) -> None:
    """Refuse an argument that is none of its parameter's choices."""
    choices = choices_in(function)
    if not choices:
        return
    try:
        given = inspect.signature(function).bind_partial(*args, **named).arguments
    except TypeError:  # one argument too many; the call says it
        return
    for name in choices.keys() & given.keys():
        check_choice(f"{_called(function)}: {name}", given[name], choices[name])


def _called(function: Callable[..., object]) -> str:
    """Name a function as its caller knows it."""
    return function.__qualname__.removesuffix(".__init__")


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
        hints = hints_of(function)
        for name, value in given.items():
            hint = hints.get(name)
            if hint is not None and not isinstance(hint, str) and not _matches_hint(value, hint):
                return wrong_type(f"{_called(function)}: {name}", value, _expected(hint))
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

"""Errors of calls with an argument of a wrong type, or that is none of its choices.

Without PyTorch, for commands that start at once.
"""

import inspect
import re
import types
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from functools import cache, partial, wraps
from numbers import Integral, Real
from pathlib import Path
from typing import Any, Literal, ParamSpec, TypeVar, Union, get_args, get_origin

from sightline.geometry.arguments import type_name, wrong_type
from sightline.geometry.choices import check_choice, choices_in, hints_of

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")
Class = TypeVar("Class", bound=type[Any])

_TYPE_ERRORS = (TypeError, AttributeError)
"""Errors that Python or a library raises for a value of another type."""


def named_arguments(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """Decorate a function so that its errors name an argument of a wrong type.

    Other types are examined only after a failure: those that work stay valid, at no cost. The error
    is a TypeError of one line with the argument, its type and the expected one. Choices
    (`Literal`), switches (`bool`), whole numbers and paths (empty, or from `~` on) are checked
    before the call: a misspelt choice, or the text "no", would silently be taken for another.
    """
    if inspect.isgeneratorfunction(function):
        return _named_in_generator(function)

    @wraps(function)
    def call(*args: Parameters.args, **named: Parameters.kwargs) -> Result:
        _check_arguments(function, args, named)
        try:
            return function(*args, **named)
        except _TYPE_ERRORS as error:
            fault = _fault(error, function, args, named)
            if fault is None:
                raise
            raise fault from error

    return call


def named_fields(kind: Class) -> Class:
    """Decorate a dataclass so that errors of its constructor name a field of a wrong type."""
    setattr(kind, "__init__", named_arguments(kind.__init__))  # noqa: B010  # mypy rejects `=`
    return kind


def _named_in_generator(function: Callable[Parameters, Any]) -> Callable[Parameters, Any]:
    """Decorate a generator function likewise; it fails at its first item."""

    @wraps(function)
    def items(*args: Parameters.args, **named: Parameters.kwargs) -> Iterator[object]:
        _check_arguments(function, args, named)
        try:
            yield from function(*args, **named)
        except _TYPE_ERRORS as error:
            fault = _fault(error, function, args, named)
            if fault is None:
                raise
            raise fault from error

    return items


def _check_arguments(
    function: Callable[..., object], args: tuple[object, ...], named: dict[str, Any]
) -> None:
    """Refuse arguments that would silently be taken for others."""
    checks = _checks_of(function)
    if checks:
        for name, value in (*zip(_parameters(function), args, strict=False), *named.items()):
            if name in checks:
                checks[name](f"{_called(function)}: {name}", value)


@cache
def _parameters(function: Callable[..., object]) -> tuple[str, ...]:
    """List the names of a function's parameters in order."""
    return tuple(inspect.signature(function).parameters)


@cache
def _checks_of(function: Callable[..., object]) -> Mapping[str, Callable[[str, object], None]]:
    """Choose the checks before a call, by parameter: of choices, whole numbers and paths."""
    checks: dict[str, Callable[[str, object], None]] = {}
    for name, hint in hints_of(function).items():
        is_union = get_origin(hint) in (Union, types.UnionType)
        parts = set(get_args(hint) if is_union else (hint,)) - {types.NoneType}
        if parts == {int}:
            checks[name] = _check_whole
        elif Path in parts:
            checks[name] = _check_path
    for name, values in choices_in(function).items():
        checks[name] = partial(check_choice, choices=values)
    checks.pop("return", None)
    return checks


def _check_whole(name: str, value: object) -> None:
    """Refuse a fraction for a whole number."""
    if isinstance(value, Integral) or not isinstance(value, Real):
        return
    if not float(value).is_integer():
        raise ValueError(f"{name} must be a whole number, got {value}")


def _check_path(name: str, value: object) -> None:
    """Refuse an empty text for a path, which would be the current folder, and `~`."""
    if isinstance(value, str) and not value:
        raise ValueError(f"{name} is an empty text, expected a path; name a file or a folder")
    if isinstance(value, str | Path) and str(value).split("/")[0] == "~":
        raise ValueError(
            f"{name} is {str(value)!r}, where ~ is a folder of that name, not the home folder; "
            "write the path in full: Path(..).expanduser()"
        )


def _called(function: Callable[..., object]) -> str:
    """Name a function as its caller knows it."""
    return function.__qualname__.removesuffix(".__init__").removesuffix(".__call__")


def _fault(
    error: Exception,
    function: Callable[..., object],
    args: tuple[object, ...],
    named: dict[str, Any],
) -> TypeError | None:
    """Find the first argument of another type than annotated.

    None if there is none, or if the error names it already, in other words than a decorated
    function that this one called: users know the function that they called.
    """
    is_named = " is of type " in str(error) and type(error.__cause__) not in _TYPE_ERRORS
    if type(error) not in _TYPE_ERRORS or is_named:
        return None
    with suppress(TypeError):  # a missing argument, or one too many
        given = inspect.signature(function).bind(*args, **named).arguments
        hints = hints_of(function)
        for name, value in given.items():
            hint = hints.get(name)
            if hint is not None and not isinstance(hint, str) and not _matches_hint(value, hint):
                expected = _expected(hint)
                expected += _conversion(value, expected)
                return wrong_type(f"{_called(function)}: {name}", value, expected)
    return None


def _conversion(value: object, expected: str) -> str:
    """End a message with the conversion between arrays and tensors, if that is the remedy."""
    given = type_name(value)
    if given == "numpy.ndarray" and "Tensor" in expected and "ndarray" not in expected:
        return "; give torch.from_numpy(array)"
    if given == "torch.Tensor" and "ndarray" in expected and "Tensor" not in expected:
        return "; give tensor.numpy(force=True)"
    return ""


def _matches_hint(value: object, hint: Any) -> bool:  # noqa: ANN401 - a type hint
    """Check the type of a value; numbers of any library count as Python's."""
    from beartype.door import is_bearable

    try:
        if is_bearable(value, hint):
            return True
        is_sequence = hasattr(value, "__getitem__") and not isinstance(value, Iterable)
        if is_sequence and get_origin(hint) is Iterable:
            return True  # such as a data set, which iter() takes
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

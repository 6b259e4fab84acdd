"""Shape and type checks of the project's functions under pytest, each made once.

`--jaxtyping-packages` decorates every function with `jaxtyping.jaxtyped`. That binds the arguments
of each call, and checks them again together with the returned value: half of what the tests took.
Here arguments and value are checked once, only calls with arrays keep account of axes, and of
these the first `MAX_CHECKED` of each function in a test are checked: loops repeat their shapes.
"""

import inspect
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import is_dataclass
from functools import update_wrapper, wraps
from types import FunctionType
from typing import Any, Final, get_args, get_type_hints

import jaxtyping
import torch
from beartype import BeartypeConf, FrozenDict, beartype
from jaxtyping import AbstractArray, TypeCheckError
from jaxtyping._import_hook import Typechecker

MAX_CHECKED: Final = 50

_num_checked: dict[FunctionType, int] = {}
_jaxtyped = jaxtyping.jaxtyped
_beartyped = beartype(
    conf=BeartypeConf(
        violation_type=TypeCheckError,
        hint_overrides=FrozenDict({int: int | torch.SymInt}),  # sizes while a network is exported
    )
)
_new_axes = _jaxtyped("context")


def install() -> None:
    """Replace the decorator that jaxtyping's import hook writes into the project's modules."""
    jaxtyping.jaxtyped = _dispatch


def begin_test() -> None:
    """Check the next `MAX_CHECKED` calls of each function with arrays."""
    _num_checked.clear()


def _dispatch(*target: Any, **settings: Any) -> Any:
    """Leave alone what the source itself decorates: checks that stay in production."""
    if settings.get("typechecker") in Typechecker.lookup.values():
        return checked(*target) if target else checked
    return _jaxtyped(*target, **settings)


def checked(target: Any) -> Any:
    """Check arguments and value of a function's calls, or the fields of a dataclass."""
    if isinstance(target, classmethod | staticmethod):
        return type(target)(checked(target.__func__))
    if isinstance(target, property):
        parts = (target.fget, target.fset, target.fdel)
        return property(*(part and checked(part) for part in parts))
    if inspect.isclass(target):
        made_by = getattr(target.__init__, "__globals__", {}).get("__name__")
        if is_dataclass(target) and made_by != _jaxtyped.__module__:
            target.__init__ = checked(target.__init__)
        return target
    hints = {name: _resolved(hint, target) for name, hint in target.__annotations__.items()}
    axes = [array.dim_str for hint in hints.values() for array in _arrays(hint)]
    computed = any("{" in each for each in axes)  # from the bound arguments
    if computed or inspect.isgeneratorfunction(target):  # whose call is checked, not its first item
        return _jaxtyped(target, typechecker=_beartyped)
    once = update_wrapper(_beartyped(_twin(target, hints)), target)
    return _with_own_axes(once, target) if axes else once


def _with_own_axes(checked_once: Callable[..., Any], function: FunctionType) -> Callable[..., Any]:
    """Check the first calls, and keep the axes of each apart from those of its caller."""

    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        __tracebackhide__ = True
        count = _num_checked.get(function, 0)
        if count >= MAX_CHECKED:
            return function(*args, **kwargs)
        _num_checked[function] = count + 1
        with _new_axes:
            return checked_once(*args, **kwargs)

    return call


def _twin(function: FunctionType, hints: dict[str, Any]) -> FunctionType:
    """Copy a function and give it other annotations."""
    twin = FunctionType(
        function.__code__,
        function.__globals__,
        function.__name__,
        function.__defaults__,
        function.__closure__,
    )
    update_wrapper(twin, function)
    del twin.__wrapped__
    twin.__kwdefaults__, twin.__annotations__ = function.__kwdefaults__, hints
    return twin


def _resolved(hint: Any, function: FunctionType) -> Any:
    """Annotation without forward references; Any if they lead nowhere, as in jaxtyping."""

    def carrier() -> None: ...

    carrier.__annotations__ = {"value": hint}
    with suppress(Exception):
        return get_type_hints(carrier, function.__globals__, include_extras=True)["value"]
    return Any


def _arrays(hint: Any) -> Iterator[Any]:
    if inspect.isclass(hint) and issubclass(hint, AbstractArray):
        yield hint
    for inner in hint if isinstance(hint, list) else get_args(hint):
        yield from _arrays(inner)

"""Dataclasses that check types and shapes of their fields, with error messages of one line."""

import re
from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

from beartype import BeartypeConf, beartype
from jaxtyping import TypeCheckError, jaxtyped

Class = TypeVar("Class", bound=type[Any])

# Whole numbers count as floats, as in Python's own type checkers.
_WIDE = BeartypeConf(is_pep484_tower=True)

_FAULT = re.compile(
    r"typechecking parameter '(?P<field>\w+)'.*?\nActual value: (?P<value>.*?)"
    r"\nExpected type: (?P<expected>.*?)\.\n",
    re.DOTALL,
)
_LONGEST = 80  # characters of a wrong value


def checked(*, wide: bool = False, remedy: str = "convert it") -> Callable[[Class], Class]:
    """Make a dataclass reject fields of other types or shapes, with a TypeError of one line.

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

        setattr(made, "__init__", init)  # noqa: B010 - mypy takes no assignment to it
        return made

    return decorate


def _in_one_line(name: str, said: str, remedy: str) -> str:
    fault = _FAULT.search(said)
    if fault is None:
        return " ".join(said.split())
    value = " ".join(fault["value"].split())
    value = value if len(value) <= _LONGEST else f"{value[:_LONGEST]}.."
    expected = re.sub(r"<class '(.*?)'>(?= \||$)", r"\1", fault["expected"])
    expected = re.sub(r"\b(jaxtyping|sightline|torch)\.([a-z_0-9]+\.)*", "", expected)
    return f"{name} takes {fault['field']} as {expected}, got {value}; {remedy}"

"""The checks that every other test runs under."""

from collections.abc import Iterator
from dataclasses import dataclass

import jaxtyping
import numpy as np
import pytest
from jaxtyping import Float64, TypeCheckError
from numpy import ndarray

from tests.shape_checks import MAX_CHECKED, begin_test, checked

ROWS = np.zeros((2, 3))


@checked
def add(a: Float64[ndarray, "n 3"], b: Float64[ndarray, "n 3"]) -> Float64[ndarray, "n 3"]:
    return a + b


@checked
def first(rows: Float64[ndarray, "n m"], count: int) -> Float64[ndarray, "{count} m"]:
    return rows[:count]


@checked
def shorten(rows: Float64[ndarray, "n m"]) -> Float64[ndarray, "n m"]:
    return rows[1:]


@checked
def halve(rows: Float64[ndarray, "n m"]) -> Float64[ndarray, "half m"]:
    return add(rows[::2], rows[::2])


@checked
def named(count: int = 1) -> str:
    return "rows" if count else 0


@checked
def numbers(count: int) -> Iterator[int]:
    yield from range(count)


@checked
def later(value: "Unknown", count: int) -> "tuple[Unknown, int]":
    return value, count


@checked
@dataclass(frozen=True)
class Rows:
    values: Float64[ndarray, "n 3"]
    weights: Float64[ndarray, " n"]

    @property
    @checked
    def size(self) -> int:
        return "2"

    @classmethod
    @checked
    def of(cls, count: int) -> "Rows":
        return cls(np.zeros((count, 3)), np.zeros(count))


def test_sound_calls_return_what_the_function_returns():
    assert add(ROWS, b=ROWS + 1).tolist() == (ROWS + 1).tolist()
    assert first(ROWS, 1).shape == (1, 3)
    assert halve(ROWS).shape == (1, 3)
    assert named() == "rows"
    assert list(numbers(2)) == [0, 1]
    assert later(None, 2) == (None, 2)
    assert Rows.of(2).values.shape == (2, 3)


@pytest.mark.parametrize(
    "call",
    [
        lambda: add(ROWS.astype(np.float32), ROWS),
        lambda: add(ROWS, ROWS[:1]),
        lambda: add(ROWS[:, :2], ROWS),
        lambda: first(ROWS, 3),
        lambda: first(ROWS, "1"),
        lambda: shorten(ROWS),
        lambda: named("1"),
        lambda: named(0),
        lambda: numbers(2.0),
        lambda: later(None, "2"),
        lambda: Rows(ROWS, np.zeros(3)),
        lambda: Rows(ROWS, [0.0, 0.0]),
        lambda: Rows.of("2"),
        lambda: Rows.of(1).size,
    ],
)
def test_wrong_types_and_shapes_are_refused(call):
    with pytest.raises(TypeCheckError):
        call()


def test_a_missing_argument_is_pythons_own_error():
    with pytest.raises(TypeError, match="missing 1 required positional argument"):
        add(ROWS)


def test_a_function_keeps_its_name_hints_and_docstring():
    assert (add.__name__, named.__annotations__) == ("add", {"count": int, "return": str})
    assert later.__annotations__["value"] == "Unknown"


def test_checks_written_in_the_source_stay_jaxtypings():
    def function(value: int) -> int:
        return value

    plain = jaxtyping.jaxtyped(function, typechecker=None)
    assert plain.__globals__["__name__"] == "jaxtyping._decorator"


def test_the_first_calls_of_a_test_are_checked_and_no_more():
    for _ in range(MAX_CHECKED):
        with pytest.raises(TypeCheckError):
            shorten(ROWS)
    assert len(shorten(ROWS)) == 1
    begin_test()
    with pytest.raises(TypeCheckError):
        shorten(ROWS)

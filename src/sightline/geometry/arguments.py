"""Parts of error messages about arguments of a wrong type.

Without PyTorch, for checks that start at once.
"""

import difflib
import reprlib
from collections.abc import Collection, Iterable, Sequence
from contextlib import suppress
from operator import index
from pathlib import Path
from typing import SupportsIndex, TypeVar

import numpy as np

Name = TypeVar("Name", bound=str)


def short_repr(value: object) -> str:
    """Format a wrong argument, short and in one line."""
    return " ".join(reprlib.repr(value).split())


def type_name(value: object) -> str:
    """Format the type of an argument, with its module unless it is a builtin."""
    kind = type(value)
    module = "" if kind.__module__ == "builtins" else f"{kind.__module__}."
    return f"{module}{kind.__name__}"


def wrong_type(name: str, value: object, expected: str) -> TypeError:
    """Make the error for an argument of a wrong type.

    Args:
        name: Name of the argument.
        value: The given value.
        expected: The expected type and the remedy, as the rest of a sentence.
    """
    return TypeError(f"{name} is of type {type_name(value)}, expected {expected}")


def json_number(value: object) -> int | float | bool:
    """Convert NumPy's numbers and switches; `default` of `json.dumps`."""
    if isinstance(value, np.number | np.bool):
        number: int | float | bool = value.item()
        return number
    raise wrong_type("a setting", value, "a number, text, or a list of them")


def plain_text(name: str, value: object) -> str:
    """Check that a value is text.

    Raises:
        TypeError: It is not.
    """
    if not isinstance(value, str):
        raise wrong_type(name, value, "text; give a name")
    return value


def check_collection(name: str, values: object) -> None:
    """Check that several texts are not given as a single one, whose letters would be taken.

    Raises:
        ValueError: The value is a text.
    """
    if isinstance(values, str):
        raise ValueError(f"{name} is the text {values!r}, expected a tuple; give ({values!r},)")


def plain_tuple(name: str, values: Iterable[str]) -> tuple[str, ...]:
    """Convert several texts, such as those of a list or an iterator, to a tuple.

    Raises:
        ValueError: They are a single text.
    """
    check_collection(name, values)
    return tuple(values)


def plain_path(name: str, value: object, expected: str) -> Path:
    """Convert a value to a path.

    Raises:
        TypeError: It is no path.
    """
    if not isinstance(value, str | Path):
        raise wrong_type(name, value, expected)
    return Path(value)


def plain_size(name: str, given: Sequence[SupportsIndex]) -> tuple[int, int]:
    """Convert integers of any type to height and width [px].

    Raises:
        ValueError: They are not two, not whole or not positive.
    """
    with suppress(TypeError):
        size = tuple(index(side) for side in given)
        if len(size) == 2 and min(size) > 0:
            return size[0], size[1]
    raise ValueError(
        f"{name} is {short_repr(given)}, expected (height, width) as whole numbers of at "
        "least 1 px; give pixels"
    )


def plain_wholes(name: str, given: Iterable[SupportsIndex]) -> tuple[int, ...]:
    """Convert several whole numbers of any integer type.

    Raises:
        TypeError: The value is no collection.
        ValueError: One is of another type.
    """
    numbers = tuple(given)
    for number in numbers:
        if isinstance(number, bool | np.bool_) or not hasattr(number, "__index__"):
            raise ValueError(
                f"{name} contains {short_repr(number)}, expected whole numbers; give them as int"
            )
    return tuple(map(index, numbers))


def sample_index(place: object, length: int) -> int:
    """Normalise the index of a sample, of any integer type; negative from the end.

    Args:
        place: The requested index.
        length: Length of the data set.

    Raises:
        IndexError: There is no such sample.
        TypeError: The index is no whole number.
    """
    if not isinstance(place, bool | np.bool_):
        with suppress(TypeError):
            number = index(place)  # type: ignore[arg-type]  # TypeError for anything else
            if not -length <= number < length:
                ends = f"; they are numbered from 0 to {length - 1}" if length else ""
                raise IndexError(f"a data set of {length} samples has no sample {number}{ends}")
            return number % length
    remedy = "for several samples: [dataset[index] for index in range(start, stop)]"
    if isinstance(place, str):
        remedy = f"for a name: dataset[dataset.sample_ids.index({short_repr(place)})]"
    raise TypeError(f"a sample index must be a whole number, got {short_repr(place)}; {remedy}")


def nearest(name: str, names: Collection[str]) -> str:
    """Make a remedy's beginning with the names similar to a misspelt one; may be empty."""
    by_word = {each.lower().replace("_", "-"): each for each in names}
    word = name.lower().replace("_", "-")
    close = difflib.get_close_matches(word, by_word, n=2)
    longer = [each for each in by_word if word and each.startswith(word)]
    if word in by_word or longer:
        close = [word] if word in by_word else longer[:3]
    meant = " or ".join(by_word[each] for each in close)
    return f"perhaps {meant} is meant; " if meant else ""


def plain_names(name: str, values: object, names: Sequence[Name]) -> tuple[Name, ...]:
    """Check several names against the known ones.

    Raises:
        TypeError: The value is no collection of texts.
        ValueError: A name is unknown.
    """
    if isinstance(values, str) or not isinstance(values, Collection):
        raise wrong_type(name, values, f"several names, such as ({names[0]!r},); give a tuple")
    for value in values:
        if value not in names:
            hint = nearest(value, names) if isinstance(value, str) else ""
            valid = ", ".join(names)
            raise ValueError(f"{name} contains {short_repr(value)}; {hint}choose from {valid}")
    return tuple(values)

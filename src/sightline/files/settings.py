"""Network settings as plain values for weights and checkpoints."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, fields
from typing import Any, ClassVar, Final, Protocol, TypeVar, runtime_checkable

import jsonargparse


@runtime_checkable  # for beartype, which checks arguments under pytest
class NetworkConfig(Protocol):
    """Dataclass of settings: every field has a default, and contains JSON values or tuples."""

    __dataclass_fields__: ClassVar[dict[str, Any]]


IN_USE_ALONE: Final = {"in_use_alone": True}
"""Metadata of a field for postprocessing, which does not affect a network's weights."""
IN_TRAINING_ALONE: Final = {"in_training_alone": True}
"""Metadata of a field that adds modules only for training: weights may lack them."""

_TRIED: Final = (
    "Does not validate against any of the Union subtypes",
    "Subtypes: ",
    "Errors:",
    "Problem with given class_path",
    "Expected a <class 'NoneType'>",
    "Given value type: ",
    "Given value: NestedArg",
    "Given value: Namespace",
)
_GIVEN: Final = "Given value: "
_LONG_VALUE: Final = 80  # characters
_PLAIN_NAMES: Final = {
    "bool": "true or false",
    "float": "a number",
    "int": "a whole number",
    "str": "text",
    "tuple": "a list, such as [a, b]",
}

ConfigT = TypeVar("ConfigT")  # a `NetworkConfig`; without a bound, as beartype cannot check classes


def config_to_dict(settings: NetworkConfig) -> dict[str, object]:
    """Convert settings to plain JSON values."""
    plain: dict[str, object] = json.loads(json.dumps(asdict(settings)))
    return plain


def parse_settings(kind: type[ConfigT], plain: Mapping[str, object]) -> ConfigT:
    """Parse settings from plain values; newer fields missing in old values have their defaults.

    Raises:
        ValueError: The values are invalid for this class; in one sentence.
    """
    parser = jsonargparse.ArgumentParser(exit_on_error=False)
    parser.add_argument("--settings", type=kind)
    try:
        parsed = parser.instantiate(parser.parse_object({"settings": dict(plain)})).settings
    except (jsonargparse.ArgumentError, ValueError) as error:
        raise ValueError(told_by_parser(str(error))) from error
    assert isinstance(parsed, kind), "the parser gives what it was asked for"
    return parsed


def told_by_parser(message: str) -> str:
    """Shorten jsonargparse's message: the fault, without the list of tried types."""
    lines = [line.strip().removeprefix("- ") for line in message.splitlines()]
    has_value = any("Got value: " in line for line in lines)
    said = " ".join(
        line
        for line in lines
        if not line.startswith(_TRIED)
        and not (line.startswith(_GIVEN) and (has_value or len(line) >= _LONG_VALUE))
    )
    for python, plain in _PLAIN_NAMES.items():
        said = said.replace(f"Expected a <class '{python}'>", f"Expected {plain}")
    return said


def _differences(
    given: Mapping[str, object], wanted: Mapping[str, object], within: str = ""
) -> Iterator[str]:
    """Yield each differing value by its path, recursively in parts that both have."""
    for name in sorted(given.keys() | wanted.keys()):
        one, other = given.get(name), wanted.get(name)
        if one == other:
            continue
        if isinstance(one, dict) and isinstance(other, dict):
            yield from _differences(one, other, f"{within}{name}.")
        else:
            yield f"{within}{name} {one} instead of {other}"


def differing_settings(
    plain: Mapping[str, object], ours: NetworkConfig, *, in_training: bool = True
) -> str:
    """Describe the differences between a file's settings and ours for the user; empty: none.

    Fields marked `IN_USE_ALONE` may differ.

    Args:
        plain: Settings of the file.
        ours: Settings of the network.
        in_training: Whether fields marked `IN_TRAINING_ALONE` are compared, too.
    """
    wanted = config_to_dict(ours)
    try:
        given = config_to_dict(parse_settings(type(ours), plain))
    except ValueError:  # settings of another network, or of a newer version
        given = config_to_dict(type(ours)()) | dict(plain)
    marks = ["in_use_alone"] if in_training else ["in_use_alone", "in_training_alone"]
    for settings in (wanted, given):
        _remove_marked(settings, ours, marks)
    return ", ".join(_differences(given, wanted))


def _remove_marked(plain: dict[str, Any], config: NetworkConfig, marks: Sequence[str]) -> None:
    """Removes the fields with one of the marks, also in nested configs."""
    for each in fields(config):
        value = getattr(config, each.name)
        if any(each.metadata.get(mark) for mark in marks):
            plain.pop(each.name, None)
        elif isinstance(value, NetworkConfig) and isinstance(plain.get(each.name), dict):
            _remove_marked(plain[each.name], value, marks)

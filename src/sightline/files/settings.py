"""Network settings as plain values for weights and checkpoints."""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, fields, is_dataclass
from typing import (
    Any,
    ClassVar,
    Final,
    Protocol,
    TypeVar,
    get_args,
    get_type_hints,
    runtime_checkable,
)

import jsonargparse

from sightline.files.plain_text import shortened


@runtime_checkable  # for beartype, which checks arguments under pytest
class NetworkConfig(Protocol):
    """Dataclass of settings: every field has a default, and contains JSON values or tuples."""

    __dataclass_fields__: ClassVar[dict[str, Any]]


INFERENCE_ONLY: Final = {"inference_only": True}
"""Metadata of a field for postprocessing, which does not affect a network's weights."""
TRAINING_ONLY: Final = {"training_only": True}
"""Metadata of a field that adds modules only for training: weights may lack them."""

_TYPE_LINES: Final = (
    "Does not validate against any of the Union subtypes",
    "Subtypes: ",
    "Errors:",
    "Problem with given class_path",
    "Expected a <class 'NoneType'>",
    "Given value type: ",
    "Given value: NestedArg",
    "Given value: Namespace",
)
_VALUE_LINE: Final = "Given value: "
_LONG_VALUE: Final = 80  # characters
_MAX_WHOLE: Final = 2**31 - 1
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
    fault = next(_faulty_values(kind, plain), None)
    if fault is not None:
        raise ValueError(f"the setting {fault}")
    parser = jsonargparse.ArgumentParser(exit_on_error=False)
    parser.add_argument("--settings", type=kind)
    try:
        parsed = parser.instantiate(parser.parse_object({"settings": dict(plain)})).settings
    except (jsonargparse.ArgumentError, ValueError) as error:
        raise ValueError(shorten_parser_error(str(error))) from error
    assert isinstance(parsed, kind), "the parser returns the requested type"
    return parsed


def _faulty_values(
    kind: type[ConfigT], plain: Mapping[str, object], within: str = ""
) -> Iterator[str]:
    """Yield faults that the parser accepts: null against the type, absurdly large numbers."""
    for name, hint in get_type_hints(kind).items():
        kinds = get_args(hint) or (hint,)
        value = plain.get(name)
        if name in plain and value is None and type(None) not in kinds:
            yield f"{within}{name} is null, expected a value"
        if isinstance(value, int) and abs(value) > _MAX_WHOLE:
            yield f"{within}{name} is {shortened(str(value), 24)}, expected up to {_MAX_WHOLE}"
        for each in kinds:
            if is_dataclass(each) and isinstance(each, type) and isinstance(value, Mapping):
                yield from _faulty_values(each, value, f"{within}{name}.")


def without_backspaces(text: str) -> str:
    """Apply the backspaces of a text, each of which removes the character before it."""
    while "\b" in text:
        text = re.sub("[^\b]?\b", "", text, count=1)
    return text


def shorten_parser_error(message: str) -> str:
    """Shorten jsonargparse's message: the fault, without the list of tried types."""
    lines = [line.strip().removeprefix("- ") for line in message.splitlines()]
    has_value = any("Got value: " in line for line in lines)
    text = " ".join(
        line
        for line in lines
        if not line.startswith(_TYPE_LINES)
        and not (line.startswith(_VALUE_LINE) and (has_value or len(line) >= _LONG_VALUE))
    )
    text = text.replace("Problems parsing config:", "--config:")
    for python, plain in _PLAIN_NAMES.items():
        text = text.replace(f"Expected a <class '{python}'>", f"Expected {plain}")
    return re.sub(r"Expected a typing\.Literal\[(.*?)\]", r"Expected one of \1", text)


def _differences(
    actual: Mapping[str, object], expected: Mapping[str, object], within: str = ""
) -> Iterator[str]:
    """Yield each differing value by its path, recursively in parts that both have."""
    for name in sorted(actual.keys() | expected.keys()):
        one, other = actual.get(name), expected.get(name)
        if one == other:
            continue
        if isinstance(one, dict) and isinstance(other, dict):
            yield from _differences(one, other, f"{within}{name}.")
        else:
            yield f"{within}{name} {one} instead of {other}"


def differing_settings(
    plain: Mapping[str, object], config: NetworkConfig, *, in_training: bool = True
) -> str:
    """Describe the differences between a file's settings and a network's; empty: none.

    Fields marked `INFERENCE_ONLY` may differ.

    Args:
        plain: Settings of the file.
        config: Settings of the network.
        in_training: Whether fields marked `TRAINING_ONLY` are compared, too.
    """
    expected = config_to_dict(config)
    try:
        actual = config_to_dict(parse_settings(type(config), plain))
    except ValueError:  # settings of another network, or of a newer version
        actual = config_to_dict(type(config)()) | dict(plain)
    marks = ["inference_only"] if in_training else ["inference_only", "training_only"]
    for settings in (expected, actual):
        _remove_marked(settings, config, marks)
    return ", ".join(_differences(actual, expected))


def _remove_marked(plain: dict[str, Any], config: NetworkConfig, marks: Sequence[str]) -> None:
    """Remove the fields with one of the marks, also in nested configs."""
    for each in fields(config):
        value = getattr(config, each.name)
        if any(each.metadata.get(mark) for mark in marks):
            plain.pop(each.name, None)
        elif isinstance(value, NetworkConfig) and isinstance(plain.get(each.name), dict):
            _remove_marked(plain[each.name], value, marks)

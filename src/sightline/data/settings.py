"""A network's settings as plain values, the way weights and checkpoints hold them."""

import json
from collections.abc import Mapping
from dataclasses import asdict, fields
from typing import Any, ClassVar, Final, Protocol, TypeVar, runtime_checkable

import jsonargparse


@runtime_checkable  # for beartype, which checks arguments under pytest
class NetworkConfig(Protocol):
    """A dataclass: every field has a default, and holds what JSON can hold, or tuples."""

    __dataclass_fields__: ClassVar[dict[str, Any]]


IN_USE_ALONE: Final = {"in_use_alone": True}
"""Metadata of a field that a network's weights do not depend on: what is made of its answers."""

ConfigT = TypeVar("ConfigT")  # a `NetworkConfig`; no bound, which beartype cannot ask classes for


def plain_settings(settings: NetworkConfig) -> dict[str, object]:
    """The settings as JSON gives them."""
    plain: dict[str, object] = json.loads(json.dumps(asdict(settings)))
    return plain


def parse_settings(kind: type[ConfigT], plain: Mapping[str, object]) -> ConfigT:
    """The settings that plain values stand for; what they are too old to name has its default.

    Raises:
        ValueError: They are none of this kind; in one sentence.
    """
    parser = jsonargparse.ArgumentParser(exit_on_error=False)
    parser.add_argument("--settings", type=kind)
    try:
        parsed = parser.instantiate(parser.parse_object({"settings": dict(plain)})).settings
    except (jsonargparse.ArgumentError, ValueError) as error:
        raise ValueError(" ".join(str(error).split())) from error
    assert isinstance(parsed, kind), "the parser gives what it was asked for"
    return parsed


def differing_settings(plain: Mapping[str, object], ours: NetworkConfig) -> str:
    """How settings from a file differ from ours, for people; empty if they do not.

    Those that only use asks for may differ.
    """
    free = {each.name for each in fields(ours) if each.metadata.get("in_use_alone")}
    wanted = plain_settings(ours)
    try:
        given = plain_settings(parse_settings(type(ours), plain))
    except ValueError:  # of another network, or a newer one
        given = plain_settings(type(ours)()) | dict(plain)
    names = sorted(
        name
        for name in (wanted.keys() | given.keys()) - free
        if wanted.get(name) != given.get(name)
    )
    return ", ".join(f"{name} {given.get(name)} instead of {wanted.get(name)}" for name in names)

"""Checks of the settings of a run: nulls, and settings of Lightning's Trainer.

jsonargparse accepts null for any setting of a configuration.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import is_dataclass
from pydoc import locate
from types import NoneType, UnionType
from typing import Any, Final, Union, get_args, get_origin, get_type_hints

from jsonargparse import Namespace

_PRECISIONS: Final = ("32-true", "bf16-mixed", "16-mixed")
_ALIASES: Final = (None, 32, "32", 16, "16", "bf16")


def check_nulls(component: str, settings: Namespace | None) -> None:
    """Refuse nulls of settings that must have a value.

    Args:
        component: Component of the settings, as on the command line: model or data.
        settings: Its class_path and init_args. Settings of unknown types are not checked.

    Raises:
        ValueError: A setting is null that must have a value.
    """
    misplaced = next(_misplaced(Any, settings, component), None)
    if misplaced is not None:
        raise ValueError(f"{misplaced} must not be null; give it a value, or leave it out")


def _misplaced(kind: Any, value: object, name: str) -> Iterator[str]:  # noqa: ANN401 - a type
    """Names of the null settings within a value, including itself, that must have a value."""
    kinds = get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,)
    if value is None:
        if not any(each in (NoneType, Any, object) for each in kinds):
            yield name
    elif isinstance(value, Namespace):
        types = _types(value, kinds)
        if "class_path" in value:
            value = value.get("init_args")
            if not any(map(is_dataclass, kinds)):  # recipes contain only the fields of these
                name += ".init_args"
        for key, inner in vars(value).items() if value else ():
            yield from _misplaced(types.get(key, Any), inner, f"{name}.{key}")
    elif isinstance(value, list | tuple):
        items = next((get_args(each) for each in kinds if _is_sequence(each)), ()) or (Any,)
        for inner in value:
            yield from _misplaced(items[0], inner, name)


def _types(value: Namespace, kinds: Sequence[Any]) -> Mapping[str, Any]:
    """Types of the arguments of a class or dataclass, by name; empty if they are unknown."""
    if "class_path" in value:
        annotated = getattr(locate(value["class_path"]), "__init__", None)
    else:
        annotated = next(filter(is_dataclass, kinds), None)
    try:
        return get_type_hints(annotated)
    except (NameError, TypeError):  # types imported only for type checkers; no types
        return {}


def _is_sequence(kind: object) -> bool:
    return get_origin(kind) in (Sequence, list, tuple)


def check_trainer_settings(settings: Namespace) -> None:
    """Refuse settings of Lightning's Trainer that fail later, or have no effect.

    Raises:
        ValueError: A setting is one of these.
    """
    precision, clip = settings["precision"], settings["gradient_clip_val"]
    if precision not in (*_PRECISIONS, *_ALIASES):
        raise ValueError(
            f"--trainer.precision {precision} does not suit these networks; take "
            f"{', '.join(_PRECISIONS[:-1])} or {_PRECISIONS[-1]}"
        )
    if clip is not None and not clip >= 0:
        raise ValueError(
            f"--trainer.gradient_clip_val must not be negative, got {clip}; leave it out to clip "
            "no gradients"
        )
    if settings["barebones"]:
        raise ValueError(
            "--trainer.barebones leaves out checkpoints and scores, so a run would have no result; "
            "leave it out"
        )

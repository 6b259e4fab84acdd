"""Comparison of a resumed run's settings with those that it began with."""

from collections.abc import Iterator, Mapping
from pathlib import Path

import yaml

from sightline.files.plain_text import shortened
from sightline.files.plain_yaml import read_yaml
from sightline.files.problem import FileError

_COMPARED = (
    "model.",
    "data.",
    "seed_everything",
    "trainer.precision",
    "trainer.accumulate_grad_batches",
    "trainer.gradient_clip",
)
"""Settings that change what is trained, by the beginnings of their names."""
_NOT_COMPARED = ("model.init_args.initial_weights", "data.init_args.workers")
_OPTIMIZER = "model.init_args.optimizer"
_MAX_LISTED = 5


def resumed_settings_note(before: Path, now: str) -> str | None:
    """Describe how a resumed run's settings differ from those that it began with.

    Args:
        before: Settings in the run's folder.
        now: Settings of the resumed training, as YAML.

    Returns:
        One line; None: nothing differs, or the run's folder holds no readable settings.
    """
    try:
        old = dict(_flat(read_yaml(before, "")))
    except FileError:
        return None
    new = dict(_flat(yaml.safe_load(now)))
    changes = [
        f"{name} {_value(old, name)}, now {_value(new, name)}"
        for name in sorted(old.keys() | new.keys())
        if name.startswith(_COMPARED)
        and name not in _NOT_COMPARED
        and _value(old, name) != _value(new, name)
    ]
    if not changes:
        return None
    more = len(changes) - _MAX_LISTED
    listed = "; ".join(changes[:_MAX_LISTED]) + (f"; {more} more" if more > 0 else "")
    kept = ""
    if any(change.startswith(_OPTIMIZER) for change in changes):
        kept = "; the optimiser and its learning rate stay as in the checkpoint"
    return f"the run began with other settings: {listed}{kept}"


def _flat(settings: object, name: str = "") -> Iterator[tuple[str, object]]:
    if isinstance(settings, Mapping) and settings:
        for key, value in settings.items():
            yield from _flat(value, f"{name}.{key}" if name else str(key))
    else:
        yield name, settings


def _value(settings: Mapping[str, object], name: str) -> str:
    return shortened(str(settings.get(name, "not set")), 60)

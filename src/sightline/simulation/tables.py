"""Tables of numbers that are kept as JSON files beside the code that uses them."""

import json
from pathlib import Path
from typing import Any


def read_table(module: str, name: str) -> dict[str, Any]:
    """Read the table of a name beside a module (its `__file__`); lists become tuples."""
    table: dict[str, Any] = json.loads(Path(module).with_name(f"{name}.json").read_text())
    return {key: _frozen(value) for key, value in table.items()}


def _frozen(value: Any) -> Any:  # noqa: ANN401 - anything that JSON can hold
    if isinstance(value, dict):
        return {key: _frozen(each) for key, each in value.items()}
    return tuple(map(_frozen, value)) if isinstance(value, list) else value

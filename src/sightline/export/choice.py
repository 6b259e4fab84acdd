"""Which engine runs a network where none is named; light, for the command line's sake."""

import os
from importlib.util import find_spec
from typing import Final, get_args

from sightline.export.names import EngineChoice, EngineName

VARIABLE: Final = "SIGHTLINE_ENGINE"
"""The environment variable that says what `auto` takes."""

_NEEDED: Final = ("openvino", "onnx", "onnxscript")


def choose_engine(choice: EngineChoice, device: str = "cpu") -> EngineName:
    """The engine that a choice means.

    `auto` is OpenVINO where the extra `export` is installed, on one core of a CPU mostly two to
    three times as fast as PyTorch, and PyTorch elsewhere and on other devices; or what the
    environment variable SIGHTLINE_ENGINE names, where it is set.

    Raises:
        ValueError: The choice or the variable names no engine.
    """
    engines: tuple[EngineName, ...] = get_args(EngineName)
    if choice != "auto":
        if choice not in engines:
            raise ValueError(f"there is no engine {choice}; name one of auto, {', '.join(engines)}")
        return choice
    if named := os.environ.get(VARIABLE):
        found = next((name for name in engines if name == named), None)
        if found is None:
            raise ValueError(
                f"the environment variable {VARIABLE} is {named!r}, which is no engine; set it to "
                f"one of {', '.join(engines)}, or leave it unset"
            )
        return found
    return "openvino" if device == "cpu" and has_openvino() else "torch"


def has_openvino() -> bool:
    """Whether OpenVINO is installed, and what turns a network into a file that it reads."""
    return all(find_spec(library) is not None for library in _NEEDED)

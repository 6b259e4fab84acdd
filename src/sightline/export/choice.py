"""Choice of the engine for a network; imports little, to keep the command line fast."""

import os
from importlib.util import find_spec
from typing import Final, get_args

from sightline.export.names import EngineChoice, EngineName

VARIABLE: Final = "SIGHTLINE_ENGINE"
"""Environment variable with the engine for `auto`."""

_NEEDED: Final = ("openvino", "onnx", "onnxscript")


def choose_engine(choice: EngineChoice, device: str = "cpu") -> EngineName:
    """Resolve a choice to an engine.

    `auto` is the engine in the environment variable SIGHTLINE_ENGINE if it is set. Otherwise it is
    OpenVINO on a CPU if the extra `export` is installed (on one core mostly two to three times as
    fast as PyTorch), else PyTorch.

    Raises:
        ValueError: The choice or the variable names no engine.
    """
    engines: tuple[EngineName, ...] = get_args(EngineName)
    if choice != "auto":
        if choice not in engines:
            raise ValueError(f"there is no engine {choice}; choose auto, {', '.join(engines)}")
        return choice
    if named := os.environ.get(VARIABLE):
        found = next((name for name in engines if name == named), None)
        if found is None:
            raise ValueError(
                f"the environment variable {VARIABLE} is {named!r}, which is no engine; set it to "
                f"one of {', '.join(engines)}, or unset it"
            )
        return found
    return "openvino" if device == "cpu" and has_openvino() else "torch"


def has_openvino() -> bool:
    """Whether OpenVINO and the libraries of the ONNX export are installed."""
    return all(find_spec(library) is not None for library in _NEEDED)

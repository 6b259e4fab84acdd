"""The libraries of the extra `export`, imported only where they are used."""

import importlib
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Literal

from sightline.data.problem import install_command

Library = Literal["onnx", "onnxruntime", "onnxscript", "openvino"]


def import_extra(library: Library) -> ModuleType:
    """Imports a library that a plain installation lacks.

    Raises:
        ValueError: It is not installed.
    """
    # ONNX Runtime's own wheels send usage data to Microsoft and leave a device id in the home
    # folder, from the import on; only this keeps them from it. A value that is set already stays.
    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
    try:
        with _no_telemetry_of_openvino():
            return importlib.import_module(library)
    except ModuleNotFoundError as error:
        if error.name != library:
            raise
        raise ValueError(
            f"{library} is not installed; install it with: {install_command('export')}"
        ) from error


@contextmanager
def _no_telemetry_of_openvino() -> Iterator[None]:
    """Hides the package by which OpenVINO sends usage data to Google, from its import on.

    Where the package is not installed, OpenVINO takes a stub of its own, and for good.
    """
    name = "openvino_telemetry"
    before = {key: module for key, module in sys.modules.items() if key == name}
    sys.modules[name] = None  # type: ignore[assignment]  # documented: imports of it then fail
    try:
        yield
    finally:
        del sys.modules[name]
        sys.modules.update(before)

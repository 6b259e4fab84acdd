"""Import of the libraries of the extra `export` at the time of use."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Literal

from sightline.files.extras import import_library

Library = Literal["onnx", "onnxruntime", "onnxscript", "openvino"]


def import_extra(library: Library) -> ModuleType:
    """Import a library of the extra `export`.

    Raises:
        ValueError: The library is not installed.
    """
    # From its import on, ONNX Runtime's wheels send usage data to Microsoft and write a device id
    # to the home folder; only this prevents it. An existing value is kept.
    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
    with _no_telemetry_of_openvino():
        return import_library(library, "export")


@contextmanager
def _no_telemetry_of_openvino() -> Iterator[None]:
    """Hide the package with which OpenVINO sends usage data to Google, during OpenVINO's import.

    If the package is not installed, OpenVINO permanently uses a stub instead.
    """
    name = "openvino_telemetry"
    before = {key: module for key, module in sys.modules.items() if key == name}
    sys.modules[name] = None  # type: ignore[assignment]  # documented: imports of it then fail
    try:
        yield
    finally:
        del sys.modules[name]
        sys.modules.update(before)

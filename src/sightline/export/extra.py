"""The libraries of the extra `export`, imported only where they are used."""

import importlib
import os
from types import ModuleType
from typing import Literal

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
        return importlib.import_module(library)
    except ModuleNotFoundError as error:
        if error.name != library:
            raise
        raise ValueError(
            f'{library} is not installed; install it with: pip install "sightline[export]"'
        ) from error

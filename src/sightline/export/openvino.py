"""Export of a PyTorch module, or its ONNX file, to OpenVINO's format (IR): `.xml` and `.bin`."""

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

from torch import Tensor, nn

from sightline.export.extra import import_extra
from sightline.export.metadata import KEYS, ExportMetadata, parse_metadata
from sightline.export.onnx import export_onnx, read_onnx_metadata
from sightline.files.atomic import DiskError, atomic_path, scratch_folder
from sightline.files.plain_text import shortened
from sightline.files.problem import SetupError


def shared_core() -> Any:  # noqa: ANN401 - an extra's
    """Return the single `openvino.Core` of this process.

    A second core is dangerous: each core gives the thread a signal stack, and cores that are not
    destroyed in reverse order leave the thread with a freed one. The next signal, such as Ctrl-C or
    the end of a worker, would then kill the process.

    Raises:
        ValueError: OpenVINO is not installed.
        SetupError: It was used before this process was forked: its threads are started only once,
            and do not exist in a fork.
    """
    process, core = _first_core()
    if process != os.getpid():
        raise SetupError(
            "openvino has run before this process was forked, and cannot run in it; start "
            "workers by spawn, use one worker, or the engine onnxruntime"
        )
    return core


@cache
def _first_core() -> tuple[int, Any]:
    """Create the core; also returns the id of its process."""
    return os.getpid(), import_extra("openvino").Core()


def export_openvino(
    module: nn.Module,
    example_inputs: Mapping[str, Tensor],
    path: Path,
    *,
    metadata: ExportMetadata,
) -> None:
    """Write a module in OpenVINO's format through ONNX; arguments as in `export_onnx`.

    Args:
        module: Module in eval mode.
        example_inputs: Inputs by parameter name of `forward`.
        path: The .xml file to write; the weights are written beside it, with the suffix .bin.
        metadata: Metadata for the .xml file.

    Raises:
        ValueError: See `export_onnx`; or `path` does not end in .xml.
    """
    import_extra("openvino")  # before the export, which takes a while
    with scratch_folder() as folder:
        onnx_path = folder / "model.onnx"
        export_onnx(module, example_inputs, onnx_path, metadata=metadata)
        convert_to_openvino(onnx_path, path)


def convert_to_openvino(onnx_path: Path, path: Path) -> None:
    """Convert an ONNX file of Sightline to OpenVINO's format, with weights in full precision.

    Raises:
        ValueError: `onnx_path` is not written by Sightline, or `path` does not end in .xml.
        DiskError: OpenVINO cannot write the files, as on a full disk.
    """
    openvino = import_extra("openvino")
    metadata = read_onnx_metadata(onnx_path)
    # Not `openvino.convert_model`, which sends usage data to Google.
    model = shared_core().read_model(str(onnx_path))
    for key, value in metadata.to_properties().items():
        model.set_rt_info(value, key.split("."))
    with ir_files(path) as aside:
        try:
            openvino.save_model(model, str(aside), compress_to_fp16=False)
        except RuntimeError as error:  # a full or broken disk, of which it gives no number
            raise DiskError(
                f"{path} cannot be written: OpenVINO says '{shortened(str(error), 80)}'; make room "
                "or choose another output folder"
            ) from error


def read_openvino_metadata(model: Any, path: Path) -> ExportMetadata:  # noqa: ANN401 - an extra's
    """Read the metadata of a loaded model.

    Args:
        model: An `openvino.Model`.
        path: File of the model, for errors.

    Raises:
        ValueError: The file is not written by Sightline.
    """
    properties = {
        key: model.get_rt_info(key.split(".")).astype(str)
        for key in KEYS
        if model.has_rt_info(key.split("."))
    }
    return parse_metadata(properties, str(path))


@contextmanager
def ir_files(path: Path) -> Iterator[Path]:
    """Yield a temporary path for a `.xml` and its `.bin`; both are moved into place when complete.

    The `.bin` is renamed first, so that a new `.xml` never exists without its weights.

    Raises:
        ValueError: `path` does not end in .xml, or its folder cannot be written to.
    """
    if path.suffix != ".xml":
        raise ValueError(f"an OpenVINO model is a file that ends in .xml, got {path}")
    weights = path.with_suffix(".bin")
    with atomic_path(path) as aside, atomic_path(weights) as weights_aside:
        yield aside
        aside.with_suffix(".bin").replace(weights_aside)

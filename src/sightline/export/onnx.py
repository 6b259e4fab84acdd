"""Export of PyTorch modules to ONNX files, by the exporter based on `torch.export`."""

import importlib
import logging
import tempfile
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jaxtyping
import torch
from torch import Tensor, nn

from sightline.export.extra import import_extra
from sightline.export.metadata import ExportMetadata, parse_metadata
from sightline.export.named_tensors import check_inputs, named_outputs
from sightline.files.atomic import atomic_path

OPSET = 20
"""Version of the ONNX operators; supported from ONNX Runtime 1.17 and OpenVINO 2024.0 on."""

_EXPORTER_LOG = "torch.onnx._internal.exporter._registration"


def export_onnx(
    module: nn.Module,
    example_inputs: Mapping[str, Tensor],
    path: Path,
    *,
    metadata: ExportMetadata,
) -> None:
    """Write a module as one ONNX file for images of any size that the stride divides.

    All inputs with four axes, `batch channels height width`, share height and width; every other
    size is fixed by the example. Outputs are named after the fields of the module's NamedTuple;
    outputs that are None for the example are left out. The graph is optimised and checked, and
    contains no data about this machine. The file is written atomically.

    Args:
        module: Module in eval mode.
        example_inputs: Inputs by parameter name of `forward`. Their values do not matter.
        path: The file to write.
        metadata: Metadata for the file.

    Raises:
        ValueError: The module is in training mode, the example's sizes are no multiples of the
            stride, an extra is missing, or the file cannot be written.
    """
    onnx = import_extra("onnx")
    import_extra("onnxscript")  # required by the exporter
    if any(part.training for part in module.modules()):
        raise ValueError("a module in training mode cannot be exported; call .eval() on it first")
    names = tuple(example_inputs)
    check_inputs(example_inputs, names, metadata.stride)
    with torch.inference_mode():
        output_names = tuple(named_outputs(module(**example_inputs)))
    tempfile.gettempdir()  # the exporter hides the lack of one behind errors of its own
    with _quiet_exporter():
        program = torch.onnx.export(
            _Flat(module, names).eval(),
            tuple(example_inputs.values()),
            dynamo=True,
            dynamic_shapes=(_dynamic_shapes(example_inputs, metadata.stride),),
            input_names=names,
            output_names=output_names,
            opset_version=OPSET,
            optimize=True,
            external_data=False,
            verbose=False,
        )
    assert program is not None, "the exporter returns a program where dynamo is set"
    model = program.model
    _strip_traces(model)
    model.metadata_props.clear()
    model.metadata_props.update(metadata.to_properties())
    with atomic_path(path) as aside:
        program.save(str(aside), external_data=False)
        onnx.checker.check_model(aside.read_bytes(), full_check=True)  # a name may be no UTF-8


def read_onnx_metadata(path: Path) -> ExportMetadata:
    """Read the metadata of a file.

    Raises:
        ValueError: The file is not written by Sightline, or `onnx` is not installed.
        OSError: The file cannot be read.
    """
    onnx = import_extra("onnx")
    decode_error: type[Exception] = importlib.import_module("google.protobuf.message").DecodeError
    try:
        model = onnx.load(str(path), load_external_data=False)
    except decode_error as error:
        raise ValueError(f"{path} is no ONNX file, or is damaged; export it again") from error
    properties = {entry.key: entry.value for entry in model.metadata_props}
    return parse_metadata(properties, str(path))


class _Flat(nn.Module):
    """Wrapper of a module with positional tensor inputs, and outputs without None."""

    def __init__(self, module: nn.Module, names: tuple[str, ...]) -> None:
        super().__init__()
        self.module = module
        self.names = names

    def forward(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        output = self.module(**dict(zip(self.names, inputs, strict=True)))
        return tuple(named_outputs(output).values())


def _dynamic_shapes(inputs: Mapping[str, Tensor], stride: int) -> tuple[dict[int, Any] | None, ...]:
    height = torch.export.Dim("height_blocks", min=1) * stride
    width = torch.export.Dim("width_blocks", min=1) * stride
    return tuple({2: height, 3: width} if tensor.ndim == 4 else None for tensor in inputs.values())


@contextmanager
def _quiet_exporter() -> Iterator[None]:
    """Silence routine messages of the exporter, and disable shape checks during the trace."""
    log = logging.getLogger(_EXPORTER_LOG)
    level = log.level
    is_unchecked = jaxtyping.config.jaxtyping_disable
    log.setLevel(logging.ERROR)  # it reports torchvision's operators, which are not used here
    # Sizes are symbols during the trace: a comparison, as in the checks of tests, would fix them to
    # the example's sizes.
    jaxtyping.config.update("jaxtyping_disable", True)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="# The axis name: .* will not be used")
            yield
    finally:
        jaxtyping.config.update("jaxtyping_disable", is_unchecked)
        log.setLevel(level)


def _strip_traces(model: Any) -> None:  # noqa: ANN401 - onnx_ir.Model, which an extra brings
    """Remove the source lines from each node: they contain folders of this machine."""
    for node in model.graph.all_nodes():
        node.metadata_props.clear()
        node.doc_string = None
        for value in node.outputs:
            value.metadata_props.clear()
    model.graph.metadata_props.clear()
    for value in (*model.graph.inputs, *model.graph.initializers.values()):
        value.metadata_props.clear()

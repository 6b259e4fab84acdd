"""From a PyTorch module to an ONNX file, by the exporter that traces with `torch.export`."""

import importlib
import logging
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jaxtyping
import torch
from torch import Tensor, nn

from sightline.data.atomic import atomic_path
from sightline.export.extra import import_extra
from sightline.export.metadata import ExportMetadata, parse_metadata
from sightline.export.named_tensors import check_inputs, named_outputs

OPSET = 20
"""Version of the ONNX operators; ONNX Runtime 1.17 and OpenVINO 2024.0 know it."""

_EXPORTER_LOG = "torch.onnx._internal.exporter._registration"


def export_onnx(
    module: nn.Module,
    example_inputs: Mapping[str, Tensor],
    path: Path,
    *,
    metadata: ExportMetadata,
) -> None:
    """Writes a module as one ONNX file that takes images of any size that the stride divides.

    All inputs with four axes, `batch channels height width`, share height and width; every other
    size stays as in the example. Outputs are named after the fields of the module's NamedTuple;
    those that are None for the example are left out. The graph is optimised and checked, and holds
    nothing of the machine that it was made on. The file is whole or not there.

    Args:
        module: In eval mode.
        example_inputs: By parameter of `forward`. Values do not matter, sizes only as said.
        path: The file to write.
        metadata: Goes into the file.

    Raises:
        ValueError: The module is in training mode, the example's sizes are no multiples of the
            stride, an extra is missing, or the file cannot be written.
    """
    onnx = import_extra("onnx")
    import_extra("onnxscript")  # the exporter's other half
    if any(part.training for part in module.modules()):
        raise ValueError("a module in training mode cannot be exported; call .eval() on it first")
    names = tuple(example_inputs)
    check_inputs(example_inputs, names, metadata.stride)
    with torch.inference_mode():
        output_names = tuple(named_outputs(module(**example_inputs)))
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
        onnx.checker.check_model(str(aside), full_check=True)


def read_onnx_metadata(path: Path) -> ExportMetadata:
    """What the file says about itself.

    Raises:
        ValueError: The file is none of ours, or `onnx` is not installed.
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
    """A module with tensors in by place, and tensors out without None."""

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
    """Keeps the exporter from reporting what is as it should be, and checks from joining in."""
    log = logging.getLogger(_EXPORTER_LOG)
    level = log.level
    is_unchecked = jaxtyping.config.jaxtyping_disable
    log.setLevel(logging.ERROR)  # it tells of operators of torchvision, which nothing here uses
    # While it is traced, sizes are symbols: to compare them, as the checks of tests do, would fix
    # them to the example's.
    jaxtyping.config.update("jaxtyping_disable", True)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="# The axis name: .* will not be used")
            yield
    finally:
        jaxtyping.config.update("jaxtyping_disable", is_unchecked)
        log.setLevel(level)


def _strip_traces(model: Any) -> None:  # noqa: ANN401 - onnx_ir.Model, which an extra brings
    """Takes off each node's record of source lines: they name folders of this machine."""
    for node in model.graph.all_nodes():
        node.metadata_props.clear()
        node.doc_string = None
        for value in node.outputs:
            value.metadata_props.clear()
    model.graph.metadata_props.clear()
    for value in (*model.graph.inputs, *model.graph.initializers.values()):
        value.metadata_props.clear()

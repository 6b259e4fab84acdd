"""Engines that run a network by PyTorch, ONNX Runtime or OpenVINO through the same interface."""

import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from operator import index
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import torch
from torch import Tensor, nn

from sightline.export.extra import import_extra
from sightline.export.metadata import ExportMetadata
from sightline.export.named_tensors import check_inputs, named_outputs
from sightline.export.names import EngineName, Precision
from sightline.export.onnx import export_onnx, read_onnx_metadata
from sightline.export.openvino import read_openvino_metadata, shared_core
from sightline.files.atomic import scratch_folder
from sightline.geometry.wrong_types import named_arguments
from sightline.jobs.worker import has_lost_threads

_SIZES_KEPT = 4  # a compiled network holds its weights and buffers


@runtime_checkable
class Engine(Protocol):
    """Network that is ready to run."""

    @property
    def name(self) -> EngineName:
        """Library that runs the network."""
        ...

    @property
    def metadata(self) -> ExportMetadata:
        """Task, configuration and stride of the network."""
        ...

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of exactly the required inputs."""
        ...

    def __call__(self, inputs: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Run the network; return its outputs by name, in float32.

        Raises:
            ValueError: An input is missing or unknown, or a size is no multiple of the stride.
        """
        ...


@named_arguments
def open_engine(
    path: Path,
    name: EngineName | None = None,
    *,
    threads: int | None = None,
    precision: Precision = "float32",
) -> Engine:
    """Open an engine for a file from `export_onnx` or `export_openvino`.

    Args:
        path: An .onnx file for ONNX Runtime or OpenVINO, or an .xml file for OpenVINO.
        name: Library that runs it; None: ONNX Runtime for .onnx and OpenVINO for .xml.
        threads: Number of CPU threads; None: the library's default.
        precision: Precision of the computation.

    Raises:
        ValueError: The library does not support the file or the precision, or is not installed; or
            the file is damaged or not written by Sightline.
    """
    readers: dict[str, EngineName] = {".onnx": "onnxruntime", ".xml": "openvino"}
    if not path.is_file() or path.suffix not in readers:
        raise ValueError(f"{path} is no .onnx or .xml file; write one with `sightline export`")
    name = name or readers[path.suffix]
    check_threads(threads)
    if name == "openvino":
        return OpenVinoEngine(path, threads=threads, precision=precision)
    if name == "onnxruntime" and path.suffix == ".onnx":
        return OnnxRuntimeEngine(path, threads=threads, precision=precision)
    raise ValueError(
        f"{name} cannot run {path}; choose the engine {readers[path.suffix]}, or export the "
        "weights in another format"
    )


@named_arguments
def build_engine(
    module: nn.Module,
    example_inputs: Mapping[str, Tensor],
    name: EngineName,
    *,
    metadata: ExportMetadata,
    threads: int | None = None,
    precision: Precision = "float32",
) -> Engine:
    """Build an engine for a module; for ONNX Runtime and OpenVINO through a temporary file.

    Args:
        module: Module in eval mode. PyTorch runs it on its own device, compiled if it is compiled;
            the other engines run it on the CPU.
        example_inputs: Inputs by parameter name of `forward`; see `export_onnx`.
        name: Library that runs the module.
        metadata: Description of the module.
        threads: Number of CPU threads; None: the library's default.
        precision: Precision of the computation.

    Raises:
        ValueError: See `open_engine` and `export_onnx`.
    """
    check_threads(threads)
    if name == "torch":
        names = tuple(example_inputs)
        return TorchEngine(module, names, metadata=metadata, threads=threads, precision=precision)
    import_extra(name)  # before the export, which takes a while
    with scratch_folder() as folder:
        path = folder / "model.onnx"
        export_onnx(module, example_inputs, path, metadata=metadata)
        return open_engine(path, name, threads=threads, precision=precision)


class TorchEngine:
    """Module run by PyTorch on its own device; the outputs stay there."""

    name: EngineName = "torch"

    @named_arguments
    def __init__(
        self,
        module: nn.Module,
        input_names: tuple[str, ...],
        *,
        metadata: ExportMetadata,
        threads: int | None = None,
        precision: Precision = "float32",
    ) -> None:
        if any(part.training for part in module.modules()):
            raise ValueError("a module in training mode cannot be run; call .eval() on it first")
        self.input_names = input_names
        self.metadata = metadata
        self._module = module
        self._threads = threads
        self._precision = precision
        self._device = next((tensor.device for tensor in module.parameters()), torch.device("cpu"))

    @torch.inference_mode()
    def __call__(self, inputs: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Run the network; see `Engine`."""
        check_inputs(inputs, self.input_names, self.metadata.stride)
        given = {name: tensor.to(self._device) for name, tensor in inputs.items()}
        is_reduced = self._precision == "bfloat16"
        with (
            _torch_threads(self._threads),
            torch.autocast(self._device.type, dtype=torch.bfloat16, enabled=is_reduced),
        ):
            outputs = named_outputs(self._module(**given))
        return {name: tensor.float() for name, tensor in outputs.items()}


class OnnxRuntimeEngine:
    """ONNX file run by ONNX Runtime on the CPU."""

    name: EngineName = "onnxruntime"

    def __init__(
        self, path: Path, *, threads: int | None = None, precision: Precision = "float32"
    ) -> None:
        if precision != "float32":
            raise ValueError(
                f"onnxruntime computes in float32 only, got {precision}; choose openvino or torch"
            )
        onnxruntime = import_extra("onnxruntime")
        self.metadata = read_onnx_metadata(path)
        options = onnxruntime.SessionOptions()
        options.log_severity_level = 3  # errors only; it warns of its own choices
        options.inter_op_num_threads = 1
        options.intra_op_num_threads = threads or 0  # 0: its default
        # otherwise its threads would occupy the cores between runs
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        try:
            self._session = onnxruntime.InferenceSession(  # not the name, which may be no UTF-8
                path.read_bytes(), options, providers=["CPUExecutionProvider"]
            )
        except Exception as error:  # its exceptions have no common base class
            raise ValueError(
                f"onnxruntime cannot read {path}: the file is damaged; export it again"
            ) from error
        self.input_names = tuple(entry.name for entry in self._session.get_inputs())
        self._output_names = tuple(entry.name for entry in self._session.get_outputs())

    def __call__(self, inputs: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Run the network; see `Engine`."""
        check_inputs(inputs, self.input_names, self.metadata.stride)
        arrays = {name: tensor.numpy(force=True) for name, tensor in inputs.items()}
        outputs = self._session.run(self._output_names, arrays)
        return dict(zip(self._output_names, map(torch.from_numpy, outputs), strict=True))


class OpenVinoEngine:
    """ONNX or OpenVINO file run by OpenVINO on the CPU; concurrent calls wait for each other.

    The network is compiled for each new input size, which takes a moment: with known sizes it runs
    up to twice as fast. The last few sizes are kept.
    """

    name: EngineName = "openvino"

    def __init__(
        self, path: Path, *, threads: int | None = None, precision: Precision = "float32"
    ) -> None:
        core = shared_core()
        if precision == "bfloat16" and "BF16" not in core.get_property(
            "CPU", "OPTIMIZATION_CAPABILITIES"
        ):
            raise ValueError(
                "this processor has no bfloat16 arithmetic for openvino; choose float32"
            )
        # Always set: OpenVINO's default is bfloat16 if the processor supports it.
        config: dict[str, Any] = {
            "INFERENCE_PRECISION_HINT": "f32" if precision == "float32" else "bf16",
            "PERFORMANCE_HINT": "LATENCY",
        }
        if threads is not None:
            config["INFERENCE_NUM_THREADS"] = threads
        try:
            model = core.read_model(str(path))
        except RuntimeError as error:
            raise ValueError(
                f"openvino cannot read {path}: the file, or the .bin beside it, is damaged or "
                "missing; export it again"
            ) from error
        self.metadata = (
            read_onnx_metadata(path)
            if path.suffix == ".onnx"
            else read_openvino_metadata(model, path)
        )
        self._model = model
        self._compile = partial(core.compile_model, device_name="CPU", config=config)
        self._compiled: dict[tuple[torch.Size, ...], Any] = {}  # by sizes, the most recent last
        self._turn = threading.Lock()  # a compiled network refuses concurrent calls
        self.input_names = tuple(entry.get_any_name() for entry in model.inputs)
        self._output_names = tuple(entry.get_any_name() for entry in model.outputs)

    def __call__(self, inputs: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Run the network; see `Engine`."""
        check_inputs(inputs, self.input_names, self.metadata.stride)
        arrays = {name: tensor.numpy(force=True) for name, tensor in inputs.items()}
        with self._turn:
            outputs = self._compiled_for(inputs)(arrays, share_inputs=True)
        return {name: torch.from_numpy(outputs[name]) for name in self._output_names}

    def _compiled_for(self, inputs: Mapping[str, Tensor]) -> Any:  # noqa: ANN401 - an extra's
        sizes = tuple(inputs[name].shape for name in self.input_names)
        compiled = self._compiled.pop(sizes, None)
        if compiled is None:
            by_name = zip(self.input_names, sizes, strict=True)
            self._model.reshape({name: list(size) for name, size in by_name})
            compiled = self._compile(self._model)
            if len(self._compiled) == _SIZES_KEPT:
                del self._compiled[next(iter(self._compiled))]
        self._compiled[sizes] = compiled
        return compiled


def check_threads(threads: int | None) -> None:
    """Refuse an invalid number of threads.

    Raises:
        ValueError: The number is not positive.
    """
    with suppress(TypeError):
        if threads is None or (not isinstance(threads, bool) and index(threads) >= 1):
            return
    raise ValueError(f"threads must be a whole number of at least 1, got {threads!r}")


@contextmanager
def _torch_threads(threads: int | None) -> Iterator[None]:
    """Set PyTorch's number of threads, a setting of the process, and restore it afterwards."""
    before = torch.get_num_threads()
    if threads is None or threads == before or has_lost_threads():
        yield
        return
    torch.set_num_threads(threads)
    try:
        yield
    finally:
        torch.set_num_threads(before)

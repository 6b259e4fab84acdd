"""Engines for jobs of several processes."""

import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import torch
from torch import Tensor

from sightline.export.engines import Engine, build_engine, open_engine
from sightline.export.extra import import_extra
from sightline.export.graph import ExportGraph
from sightline.export.names import EngineName
from sightline.export.onnx import export_onnx


class ProcessEngine:
    """Runs a network; may be pickled, and used in a forked process.

    Neither threads nor a GPU's state cross over to another process. So each makes its own engine,
    when it first runs the network; what takes long, the export, is done once, before.
    """

    def __init__(
        self,
        graph: ExportGraph,
        *,
        name: EngineName,
        device: str = "cpu",
        threads: int | None = None,
    ) -> None:
        """Exports the network where the engine needs it.

        Raises:
            ValueError: The engine is not installed, or runs on the CPU only.
        """
        if name != "torch" and device != "cpu":
            raise ValueError(f"{name} runs on the cpu only, got {device}; choose the engine torch")
        self.name: EngineName = name
        self._graph = graph
        self._device = device
        self._threads = threads
        self._onnx = None if name == "torch" else _to_onnx(graph, name)
        self._made: dict[int, Engine] = {}  # by process

    def __call__(self, inputs: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Runs the network as `Engine` does.

        Raises:
            ValueError: The device cannot be used, OpenVINO has run before this process was forked,
                or as `Engine` says.
        """
        process = os.getpid()
        if process not in self._made:
            # A forked process keeps its parent's engine: to end it is to wait for its threads.
            self._made[process] = self._make()
        return self._made[process](inputs)

    def __getstate__(self) -> dict[str, object]:
        """All but what belongs to this process."""
        return {**self.__dict__, "_made": {}}

    def _make(self) -> Engine:
        if self._onnx is None:
            return _torch_engine(self._graph, self._device, self._threads)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "model.onnx"
            path.write_bytes(self._onnx)
            return open_engine(path, self.name, threads=self._threads)


def _torch_engine(graph: ExportGraph, device: str, threads: int | None) -> Engine:
    try:
        module = graph.module.to(torch.device(device))
    except (RuntimeError, AssertionError) as error:  # the latter where torch has no CUDA at all
        reason = str(error).split("\n", maxsplit=1)[0]
        raise ValueError(f"device {device} cannot be used ({reason}); choose cpu") from error
    return build_engine(
        module, graph.example_inputs, "torch", metadata=graph.metadata, threads=threads
    )


def _to_onnx(graph: ExportGraph, name: Literal["onnxruntime", "openvino"]) -> bytes:
    import_extra(name)  # before the export, which takes a while
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.onnx"
        export_onnx(graph.module, graph.example_inputs, path, metadata=graph.metadata)
        return path.read_bytes()

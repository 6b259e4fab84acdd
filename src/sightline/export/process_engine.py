"""Engines for jobs with several processes."""

import os
from collections.abc import Mapping

import torch
from torch import Tensor

from sightline.export.choice import choose_engine
from sightline.export.engines import Engine, build_engine, check_threads, open_engine
from sightline.export.extra import import_extra
from sightline.export.graph import ExportGraph
from sightline.export.kept_files import onnx_file_of
from sightline.export.names import EngineChoice, EngineName
from sightline.files.atomic import scratch_folder
from sightline.files.plain_text import shortened
from sightline.files.problem import SetupError
from sightline.geometry.user_warning import warn_user

_REASON_LENGTH = 160  # characters


class ProcessEngine:
    """Engine that can be pickled, and used in a forked process.

    Threads and GPU state cannot be shared with another process. So each process creates its own
    engine when it first runs the network; the slow export is done once, before.
    """

    def __init__(
        self,
        graph: ExportGraph,
        *,
        name: EngineChoice,
        device: str = "cpu",
        threads: int | None = None,
    ) -> None:
        """Export the network if the engine needs it and it is not cached.

        `auto` falls back to PyTorch, with a warning, if the network cannot be exported.

        Raises:
            ValueError: The engine is not installed or runs on the CPU only, or the device or the
                number of threads is invalid.
        """
        check_threads(threads)
        device = str(device)  # may be a torch.device
        chosen = choose_engine(name, device)
        if chosen != "torch" and device != "cpu":
            raise ValueError(
                f"{chosen} runs on the cpu only, got {device}; choose the engine torch"
            )
        check_device(device)
        self._graph = graph
        self._device = device
        self._threads = threads
        self._onnx: bytes | None = None
        if chosen != "torch":
            import_extra(chosen)  # before the export, which takes a while
            try:
                self._onnx = onnx_file_of(graph)
            except torch.onnx.OnnxExporterError as error:
                if name != "auto":
                    raise
                reason = shortened(" ".join(str(error).split()), _REASON_LENGTH)
                warn_user(
                    f"PyTorch runs the network, as it cannot be exported for {chosen}: {reason}",
                )
                chosen = "torch"
        self.name: EngineName = chosen
        self._made: dict[int, Engine] = {}  # by process

    def __call__(self, inputs: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Run the network as `Engine` does.

        Raises:
            ValueError: The device cannot be used, OpenVINO has run before this process was forked,
                or see `Engine`.
        """
        process = os.getpid()
        if process not in self._made:
            # A forked process keeps its parent's engine: deleting it would wait for its threads.
            self._made[process] = self._make()
        return self._made[process](inputs)

    def __getstate__(self) -> dict[str, object]:
        """State without the engines of this process."""
        return {**self.__dict__, "_made": {}}

    def _make(self) -> Engine:
        if self._onnx is None:
            return _torch_engine(self._graph, self._device, self._threads)
        with scratch_folder() as folder:
            path = folder / "model.onnx"
            path.write_bytes(self._onnx)
            return open_engine(path, self.name, threads=self._threads)


def check_device(device: str) -> None:
    """Refuse a missing device without initialising it: a fork could not use it afterwards.

    Raises:
        SetupError: There is no such device, or it is neither a CPU nor a GPU of CUDA.
    """
    try:
        kind = torch.device(device).type
    except RuntimeError as error:
        raise _unusable(device, error) from error
    if kind not in ("cpu", "cuda"):
        raise _unusable(device, "neither cpu nor cuda")
    if kind == "cuda" and not torch.cuda.device_count():
        raise _unusable(device, "no GPU found")


def _unusable(device: str, reason: object) -> SetupError:
    first_line = str(reason).split("\n", maxsplit=1)[0]
    return SetupError(f"device {device} cannot be used ({first_line}); choose cpu")


def _torch_engine(graph: ExportGraph, device: str, threads: int | None) -> Engine:
    try:
        module = graph.module.to(torch.device(device))
    except (RuntimeError, AssertionError) as error:  # AssertionError: torch without CUDA
        raise _unusable(device, error) from error
    return build_engine(
        module, graph.example_inputs, "torch", metadata=graph.metadata, threads=threads
    )

"""Cache of exported networks: an export takes ten seconds.

The files are in the user's `cache_folder`, which may be deleted at any time. The key of a file
covers all its inputs: weights, settings, Sightline's own code and the exporter's version.
"""

import hashlib
import os
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Final

import torch

from sightline.export.graph import ExportGraph
from sightline.export.onnx import OPSET, export_onnx
from sightline.files.atomic import atomic_write_bytes, scratch_folder
from sightline.ops.cache_folder import cache_folder

_MAX_FILES: Final = 24
_DIGEST_BYTES: Final = 32
_FOLDERS_WITHOUT_NETWORKS: Final = (
    "cli", "corruptions", "health", "robustness", "simulation", "training", "visualization"
)  # fmt: skip
"""Folders whose code does not affect any graph."""
_CACHED_PACKAGES: Final = ("sightline", "torch", "torchvision")


def onnx_file_of(graph: ExportGraph) -> bytes:
    """Return a graph as the content of an ONNX file, from the cache or by a new export.

    Only modules of Sightline and PyTorch are cached. Code changes of other modules are not
    detected, so those are exported every time.

    Raises:
        ValueError: See `export_onnx`.
    """
    return _kept(graph, lambda: _export(graph)) if _is_cacheable(graph) else _export(graph)


def _export(graph: ExportGraph) -> bytes:
    from sightline.jobs.progress import waiting  # rich: not needed where the file is kept

    message = f"converting a {graph.metadata.task} network (cached afterwards)"
    with waiting(message), scratch_folder() as folder:
        path = folder / "model.onnx"
        export_onnx(graph.module, graph.example_inputs, path, metadata=graph.metadata)
        return path.read_bytes()


def _kept(graph: ExportGraph, export: Callable[[], bytes]) -> bytes:
    folder = cache_folder()
    if folder is None:
        return export()
    path = folder / f"{_digest(graph)}.onnx"
    with suppress(OSError):
        content = path.read_bytes()
        digest, onnx = content[:_DIGEST_BYTES], content[_DIGEST_BYTES:]
        if hashlib.sha256(onnx).digest() == digest:  # otherwise it is damaged, and exported again
            with suppress(OSError):  # a read-only folder still provides its files
                os.utime(path)
            return onnx
    onnx = export()
    with suppress(OSError, ValueError):  # a full disk or read-only folder: no caching
        atomic_write_bytes(path, hashlib.sha256(onnx).digest() + onnx)
        _drop_oldest(folder)
    return onnx


def _drop_oldest(folder: Path) -> None:
    by_age = sorted(folder.glob("*.onnx"), key=lambda path: path.stat().st_mtime)
    for path in by_age[:-_MAX_FILES]:
        path.unlink(missing_ok=True)


def _is_cacheable(graph: ExportGraph) -> bool:
    names = {type(module).__module__.partition(".")[0] for module in graph.module.modules()}
    return names <= set(_CACHED_PACKAGES)


def _digest(graph: ExportGraph) -> str:
    """Digest of all inputs of the file."""
    digest = hashlib.sha256()
    versions = [f"{name} {version(name)}" for name in ("torch", "onnx", "onnxscript")]
    inputs = [f"{name} {tuple(each.shape)}" for name, each in graph.example_inputs.items()]
    settings = sorted(graph.metadata.to_properties().items())
    for message in (
        _code_digest(),
        str(OPSET),
        *versions,
        *inputs,
        str(settings),
        str(graph.module),
    ):
        digest.update(message.encode() + b"\0")
    tensors = dict(graph.module.named_parameters()) | dict(graph.module.named_buffers())
    for name, tensor in tensors.items():
        digest.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}".encode() + b"\0")
        digest.update(tensor.detach().cpu().flatten().view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()


@cache
def _code_digest() -> str:
    """Digest of Sightline's own code, which also changes between two releases."""
    root = Path(__file__).parent.parent
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        if path.relative_to(root).parts[0] in _FOLDERS_WITHOUT_NETWORKS:
            continue
        digest.update(str(path.relative_to(root)).encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()

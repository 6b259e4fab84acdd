"""Weights files: a network's weights and the settings for rebuilding it."""

import json
import pickle
import warnings
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import safetensors
import torch
from safetensors.torch import save
from torch import Tensor, nn

from sightline.files.atomic import atomic_write_bytes
from sightline.files.plain_text import shortened
from sightline.files.weights_header import (
    METADATA_KEY,
    WEIGHTS_REMEDY,
    WeightsDescription,
    check_description,
    find_weights,
    read_description,
)

CHECKPOINT_KEY: Final = "sightline"
"""Key of the task, the network's config and the provenance in a training checkpoint."""
NETWORK_PREFIX: Final = "network."
"""Prefix of the network's tensors in a training checkpoint."""

_CHECKPOINT_REMEDY = "name one that sightline fit wrote"
_REASON_LENGTH = 160  # characters of another library's message
_MAX_AXES = 8
_NO_ARRAY = "is no plain array of numbers"
_HALF_TYPES = (torch.float16, torch.bfloat16)
_TENSOR_TYPES = frozenset(
    {torch.float64, torch.float32, torch.float16, torch.bfloat16, torch.int64, torch.int32}
    | {torch.int16, torch.int8, torch.uint8, torch.bool}
)


@dataclass(frozen=True, kw_only=True)
class Weights:
    """Weights and description of a trained network."""

    task: str
    """Task of the network."""
    config: dict[str, object]
    """The network's settings as plain JSON values."""
    provenance: dict[str, str]
    """Origin of the weights, for people: version, seed, steps, .."""
    tensors: dict[str, Tensor]
    """Tensors by their names in the network's `state_dict`; on the CPU, all finite."""


def write_weights(
    path: Path | str,
    tensors: Mapping[str, Tensor],
    *,
    task: str,
    config: Mapping[str, object],
    provenance: Mapping[str, str],
) -> None:
    """Write weights as safetensors, which contain no code, with a description as JSON metadata.

    The same weights give the same bytes. The file is written atomically.

    Args:
        path: Target path.
        tensors: A network's `state_dict`.
        task: Task of the network.
        config: Settings of the network, only JSON values.
        provenance: Origin of the weights.

    Raises:
        ValueError: The file cannot be written.
    """
    description = {"task": task, "config": dict(config), "provenance": dict(provenance)}
    # Copied: tensors with shared memory are refused, and a network may tie its weights.
    copied = {
        name: tensor.detach().to("cpu", copy=True).contiguous() for name, tensor in tensors.items()
    }
    metadata = {METADATA_KEY: json.dumps(description, sort_keys=True)}
    atomic_write_bytes(path, save(copied, metadata))  # save_file's are readable only by the user


def read_weights(weights: Path | str) -> Weights:
    """Read weights: shipped ones, a file of `write_weights`, or a training checkpoint (.ckpt).

    The type is recognised by the content, not by the name. No code in the file is run.

    Raises:
        ValueError: There are no such weights, or the file is damaged, contains non-finite weights,
            or has no description of its network; the error names the file, in one line.
    """
    path = find_weights(weights)
    if _is_archive(path):
        return read_checkpoint_weights(path)
    description = read_description(path)
    try:
        with safetensors.safe_open(path, framework="pt") as file:
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - no dict
    except (safetensors.SafetensorError, OSError, RuntimeError, ValueError) as error:
        raise ValueError(
            f"{path} cannot be read as safetensors ({_reason(error)}); it is cut short or damaged: "
            f"{WEIGHTS_REMEDY}"
        ) from error
    return _weights(path, description, tensors)


def read_checkpoint_weights(path: Path | str) -> Weights:
    """Read the network's weights from a training checkpoint, without running code from it.

    If the training averages weights, these are the averages.

    Raises:
        ValueError: The file is damaged, no checkpoint of a sightline training, or contains
            non-finite weights; the error names the file, in one line.
    """
    path = Path(path)
    _check_archive(path)
    try:
        with path.open("rb") as file, warnings.catch_warnings():  # a path's suffix could mislead it
            warnings.simplefilter("ignore")  # the causes of its warnings are refused below
            checkpoint = torch.load(file, map_location="cpu", weights_only=True)
    except pickle.UnpicklingError as error:
        # PyTorch's message would explain how to run the code anyway.
        raise ValueError(
            f"{path} holds other Python objects than plain values and tensors, which could run "
            f"code when they are read, or is damaged; {_CHECKPOINT_REMEDY}"
        ) from error
    except Exception as error:
        # Its reader may raise almost anything for damaged bytes: KeyError, AttributeError, ..
        raise ValueError(
            f"{path} cannot be read as a checkpoint ({_reason(error)}); {_CHECKPOINT_REMEDY}"
        ) from error
    match checkpoint:
        case {"sightline": described, "state_dict": dict(state)}:
            tensors = {
                name.removeprefix(NETWORK_PREFIX): tensor
                for name, tensor in state.items()
                if isinstance(name, str) and name.startswith(NETWORK_PREFIX)
            }
            return _weights(path, check_description(path, described), tensors)
    raise ValueError(f"{path} is no checkpoint of sightline; {_CHECKPOINT_REMEDY}")


@contextmanager
def plain_defaults() -> Iterator[None]:
    """Set PyTorch's defaults to float32 on the CPU for loading weights, and restore them."""
    before = torch.get_default_dtype()
    # entered only where it is needed: it slows down every call of PyTorch
    is_elsewhere = torch.get_default_device().type != "cpu"
    if before != torch.float32:
        torch.set_default_dtype(torch.float32)
    try:
        with torch.device("cpu") if is_elsewhere else nullcontext():
            yield
    finally:
        if before != torch.float32:
            torch.set_default_dtype(before)


def fill_network(network: nn.Module, tensors: Mapping[str, Tensor]) -> None:
    """Load weights into a network; half-precision weights are converted.

    Raises:
        ValueError: Names, shapes or types differ from the network's; names the first difference.
    """
    expected = network.state_dict()
    for name in sorted(expected.keys() | tensors.keys()):
        if name not in tensors:
            raise ValueError(f"the tensor {name} is missing")
        if name not in expected:
            raise ValueError(f"there is no place for the tensor {shortened(name)}")
        tensor = tensors[name]
        if tensor.dtype in _HALF_TYPES and expected[name].dtype == torch.float32:
            tensor = tensor.float()
        if _kind(tensor) != _kind(expected[name]):
            raise ValueError(
                f"the tensor {name} is {_kind(tensor)}, expected {_kind(expected[name])}"
            )
    network.load_state_dict(dict(tensors))


def _kind(tensor: Tensor) -> str:
    return f"{str(tensor.dtype).removeprefix('torch.')} {list(tensor.shape)}"


def _is_archive(path: Path) -> bool:
    try:
        return zipfile.is_zipfile(path)
    except zipfile.BadZipFile:  # a damaged one: Python before 3.13 raises for some
        return True


def _check_archive(path: Path) -> None:
    """Refuse an archive that is larger than its file, as PyTorch packs nothing, or is damaged.

    PyTorch itself does not compare the checksums: flipped bytes would become weights.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            unpacked = sum(entry.file_size for entry in archive.infolist())
            is_packed = unpacked > path.stat().st_size
            damaged = None if is_packed else archive.testzip()
    except Exception as error:
        # For damaged bytes the library raises errors of many types: RuntimeError, zlib.error, ..
        raise ValueError(
            f"{path} cannot be read as a checkpoint ({_reason(error)}); {_CHECKPOINT_REMEDY}"
        ) from error
    if is_packed or damaged is not None:
        problem = (
            f"it is packed, to hold {unpacked} bytes"
            if is_packed
            else f"the checksum of {shortened(str(damaged))} in it does not fit: it is damaged"
        )
        raise ValueError(f"{path} cannot be read as a checkpoint ({problem}); {_CHECKPOINT_REMEDY}")


def _weights(path: Path, described: WeightsDescription, tensors: Mapping[str, object]) -> Weights:
    checked: dict[str, Tensor] = {}
    for name, tensor in tensors.items():
        fault = _fault(tensor) if isinstance(tensor, Tensor) else _NO_ARRAY
        if fault:
            raise ValueError(
                f"{path} cannot be used: its tensor {shortened(name)} {fault}; take weights from "
                "before the training diverged, or from an undamaged file"
            )
        assert isinstance(tensor, Tensor), "anything else is at fault"
        checked[name] = tensor
    return Weights(
        task=described.task,
        config=described.config,
        provenance=described.provenance,
        tensors=checked,
    )


def _fault(tensor: Tensor) -> str:
    """Describe the fault of a network's tensor; empty: none."""
    is_plain = tensor.layout == torch.strided and tensor.device.type == "cpu"
    if not is_plain or tensor.dtype not in _TENSOR_TYPES or tensor.ndim > _MAX_AXES:
        return _NO_ARRAY
    if tensor.untyped_storage().nbytes() < tensor.numel() * tensor.itemsize:
        return "claims more numbers than the file holds"  # with strides of zero
    if not tensor.isfinite().all():
        return "holds NaN or infinite values"
    return ""


def _reason(error: Exception) -> str:
    return shortened(" ".join(str(error).split()), _REASON_LENGTH) or type(error).__name__

"""A network's weights together with what is needed to build it again: one file."""

import json
import pickle
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import safetensors
import torch
from safetensors.torch import save
from torch import Tensor

from sightline.data.atomic import atomic_write_bytes

CHECKPOINT_KEY: Final = "sightline"
"""Where a training checkpoint tells its task, the network's config and its provenance."""
NETWORK_PREFIX: Final = "network."
"""Names of the network's tensors in a training checkpoint begin with this."""

_SHIPPED: Final = Path(__file__).parents[1] / "weights"
_METADATA_KEY = "sightline"  # one key only: safetensors writes several in random order
_REMEDY = "name a weights file that sightline wrote, or export it again from the run's checkpoint"


@dataclass(frozen=True, kw_only=True)
class Weights:
    """A trained network: its numbers and its description."""

    task: str
    """Which task's network this is."""
    config: dict[str, object]
    """The network's settings in plain values, as JSON gives them."""
    provenance: dict[str, str]
    """Where the weights come from, for people: version, seed, steps, .."""
    tensors: dict[str, Tensor]
    """By name, as the network's `state_dict` has them; on the CPU."""


def write_weights(
    path: Path | str,
    tensors: Mapping[str, Tensor],
    *,
    task: str,
    config: Mapping[str, object],
    provenance: Mapping[str, str],
) -> None:
    """Writes weights as safetensors, which hold no code; the description is JSON in the metadata.

    The same weights give the same bytes. The file appears whole or not at all.

    Args:
        path: Where the file shall stand.
        tensors: A network's `state_dict`.
        task: Which task's network this is.
        config: Its settings; only what JSON can hold.
        provenance: Where the weights come from.

    Raises:
        ValueError: The place cannot be written to.
    """
    description = {"task": task, "config": dict(config), "provenance": dict(provenance)}
    # Copied: tensors that share memory would be refused, and a network may tie its weights.
    copied = {
        name: tensor.detach().to("cpu", copy=True).contiguous() for name, tensor in tensors.items()
    }
    metadata = {_METADATA_KEY: json.dumps(description, sort_keys=True)}
    atomic_write_bytes(path, save(copied, metadata))  # save_file's own files are for the user alone


def shipped_names() -> tuple[str, ...]:
    """Names of the weights that come with the package."""
    return tuple(sorted(path.stem for path in _SHIPPED.glob("*.safetensors")))


def find_weights(weights: Path | str) -> Path:
    """The file of weights that are told by their file, or by name where the package holds them.

    Raises:
        ValueError: There are no such weights.
    """
    if str(weights) in shipped_names():
        return _SHIPPED / f"{weights}.safetensors"
    path = Path(weights)
    if not path.is_file():
        raise ValueError(
            f"there are no weights {str(weights)!r}; give a file (.safetensors, .ckpt) or the name "
            f"of weights that come with sightline ({', '.join(shipped_names()) or 'none do'})"
        )
    return path


def read_weights(weights: Path | str) -> Weights:
    """Reads weights: shipped ones, a file of `write_weights`, or a training checkpoint (.ckpt).

    Raises:
        ValueError: There are no such weights, or the file is damaged or says not what network it
            is for.
    """
    path = find_weights(weights)
    if zipfile.is_zipfile(path):
        return read_checkpoint_weights(path)
    try:
        with safetensors.safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - no dict
    except (safetensors.SafetensorError, OSError) as error:
        raise ValueError(
            f"{path} cannot be read as safetensors ({error}); it is cut short or of another kind: "
            f"{_REMEDY}"
        ) from error
    if _METADATA_KEY not in metadata:
        raise ValueError(f"{path} does not tell what network its weights are for; {_REMEDY}")
    return _describe(path, json.loads(metadata[_METADATA_KEY]), tensors)


def read_checkpoint_weights(path: Path | str) -> Weights:
    """Reads the network's weights from a training checkpoint, without running code from it.

    Where the training averages weights, these are the averages.

    Raises:
        ValueError: The file is damaged, or no checkpoint of a sightline training.
    """
    try:
        checkpoint = torch.load(path, map_location="cpu", weights_only=True)
    except (OSError, RuntimeError, EOFError, pickle.UnpicklingError) as error:
        reason = str(error).split("\n", maxsplit=1)[0]
        raise ValueError(
            f"{path} cannot be read as a checkpoint ({reason}); name one that sightline fit wrote"
        ) from error
    if not isinstance(checkpoint, dict) or CHECKPOINT_KEY not in checkpoint:
        raise ValueError(f"{path} is no checkpoint of sightline; name one that sightline fit wrote")
    tensors = {
        name.removeprefix(NETWORK_PREFIX): tensor
        for name, tensor in checkpoint["state_dict"].items()
        if name.startswith(NETWORK_PREFIX)
    }
    return _describe(path, checkpoint[CHECKPOINT_KEY], tensors)


def _describe(path: Path | str, description: object, tensors: dict[str, Tensor]) -> Weights:
    match description:
        case {"task": str(task), "config": dict(config), "provenance": dict(provenance)}:
            return Weights(task=task, config=config, provenance=provenance, tensors=tensors)
    raise ValueError(f"{path} describes its weights in an unknown way; {_REMEDY}")

"""Trained networks of any task, by name or file."""

import hashlib
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar, runtime_checkable

from torch import nn

from sightline.files.plain_text import shortened
from sightline.files.settings import parse_settings
from sightline.files.weights import Weights, fill_network, plain_defaults, read_weights
from sightline.files.weights_header import find_weights
from sightline.inference.size_limit import size_limit

_MAX_REASON_LENGTH = 240  # characters

Network = TypeVar("Network", bound=nn.Module)
Network_co = TypeVar("Network_co", bound=nn.Module, covariant=True)


@runtime_checkable  # for beartype, which checks arguments under pytest
class NetworkTask(Protocol[Network_co]):
    """Part of a task's interface that concerns its network."""

    @property
    def name(self) -> str:
        """Name of the task in weights files."""
        ...

    def config_type(self) -> type[Any]:
        """Dataclass of the network's settings."""
        ...

    def build(self, config: Any) -> Network_co:  # noqa: ANN401 - an instance of `config_type`
        """Build a network from settings, with random weights."""
        ...


@dataclass(frozen=True, kw_only=True, slots=True)
class LoadedNetwork(Generic[Network]):
    """Trained network with its metadata."""

    network: Network
    """Network for inference, on the CPU, without gradients."""
    weights: Weights
    name: str
    """Name of the weights: their file name without its suffix."""
    path: Path
    sha256: str
    """SHA-256 of the file's content."""

    @property
    def provenance(self) -> dict[str, str]:
        """Origin and identity of the weights."""
        return {**self.weights.provenance, "weights": self.name, "sha256": self.sha256}


def load_network(task: NetworkTask[Network], weights: str | Path) -> LoadedNetwork[Network]:
    """Build a task's network and load its weights.

    Args:
        task: Task of the network.
        weights: Name of weights in the package, or a file: a weights file (.safetensors) or a
            training checkpoint (.ckpt).

    Raises:
        ValueError: There are no such weights, they belong to another task's network, or to a
            network that this version cannot build.
    """
    path = find_weights(weights)
    read = read_weights(path)
    if read.task != task.name:
        raise ValueError(
            f"{path} holds weights for {shortened(read.task)}, expected {task.name}; give another "
            "file"
        )
    try:
        config = parse_settings(task.config_type(), read.config)
        with size_limit(read.tensors), plain_defaults():
            network = task.build(config)
        fill_network(network, read.tensors)
    except Exception as error:
        # Unforeseen settings can raise almost anything: OverflowError, TypeError, ..
        made_by = shortened(read.provenance.get("sightline", "another version"), 24)
        remedy = "use that version, or train the weights again"
        if made_by == version("sightline"):
            remedy = "take the file as it was written, or train the weights again"
        reason = shortened(" ".join(str(error).split()), _MAX_REASON_LENGTH)
        raise ValueError(
            f"{path} does not fit this version's network (it was made by sightline {made_by}): "
            f"{reason}; {remedy}"
        ) from error
    return LoadedNetwork(
        network=network.eval().requires_grad_(requires_grad=False),
        weights=read,
        name=path.stem,
        path=path,
        sha256=hashlib.sha256(path.read_bytes()).hexdigest(),
    )

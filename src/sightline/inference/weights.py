"""Trained networks by name or file."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

import jsonargparse
import torch
from torch import Tensor

from sightline.depth_completion.config import DepthCompletionConfig
from sightline.depth_completion.model import DepthCompletionNet
from sightline.export.metadata import ExportMetadata
from sightline.training.checkpoint import Weights, find_weights, read_weights

_TASK = "depth-completion"


@dataclass(frozen=True, kw_only=True, slots=True)
class LoadedNetwork:
    """A trained network with what is known about it."""

    network: DepthCompletionNet
    """For inference, on the CPU; it takes no gradients."""
    weights: Weights
    name: str
    """The weights' name: that of their file, without its ending."""
    path: Path
    sha256: str
    """Of the file's content."""

    @property
    def metadata(self) -> ExportMetadata:
        """What an exported file says about itself."""
        return ExportMetadata(
            task=self.weights.task,
            config=self.weights.config,
            stride=self.network.stride,
            provenance={**self.weights.provenance, "weights": self.name, "sha256": self.sha256},
        )

    def example_inputs(self) -> dict[str, Tensor]:
        """Inputs by the names that the network's `forward` takes; their size stands for any."""
        size = (4 * self.network.stride, 6 * self.network.stride)
        channels = {"image": 3, "sparse_depth_m": 1}
        if self.network.takes_filled_depth:
            channels["filled_depth_m"] = 1
        # Each a tensor of its own: the exporter takes one that stands twice for a single input.
        return {name: torch.ones(1, count, *size) for name, count in channels.items()}


def load_network(weights: str | Path) -> LoadedNetwork:
    """Builds a depth completion network and gives it its weights.

    Args:
        weights: Name of weights that come with the package, or a file: one of ours
            (.safetensors) or a checkpoint of a training (.ckpt).

    Raises:
        ValueError: There are no such weights, they are of another task's network, or of a network
            that this version cannot build.
    """
    path = find_weights(weights)
    read = read_weights(path)
    if read.task != _TASK:
        raise ValueError(
            f"{path} holds weights for {read.task}, expected {_TASK}; name another file"
        )
    try:
        network = DepthCompletionNet(_parse_config(read.config))
        network.load_state_dict(read.tensors)
    except (jsonargparse.ArgumentError, RuntimeError, ValueError) as error:
        made_by = read.provenance.get("sightline", "another version")
        reason = " ".join(str(error).split())
        raise ValueError(
            f"{path} does not fit this version's network (it was made by sightline {made_by}): "
            f"{reason}; use that version, or train the weights again"
        ) from error
    return LoadedNetwork(
        network=network.eval().requires_grad_(requires_grad=False),
        weights=read,
        name=path.stem,
        path=path,
        sha256=hashlib.sha256(path.read_bytes()).hexdigest(),
    )


def _parse_config(values: dict[str, object]) -> DepthCompletionConfig:
    parser = jsonargparse.ArgumentParser(exit_on_error=False)
    parser.add_argument("--config", type=DepthCompletionConfig)
    parsed = parser.instantiate(parser.parse_object({"config": values}))
    config = parsed.config
    assert isinstance(config, DepthCompletionConfig), "the parser gives what it was asked for"
    return config

"""Streams from networks that had one sensor, which a network of both then learns to join."""

from collections.abc import Mapping
from pathlib import Path

from torch import Tensor

from sightline.data.weights import fill_network, read_weights
from sightline.detection2d.model import Detector


def load_stream_weights(network: Detector, sources: Mapping[str, Path], *, task_name: str) -> None:
    """Gives streams of a network the weights of streams of the same name in others.

    A stream's own head, where it is in use (`CompactConfig.own_heads`), comes with it.

    Args:
        network: Its other weights stay.
        sources: By stream, camera, lidar or both: name of shipped weights, file or checkpoint.
        task_name: The task that they must be of.

    Raises:
        ValueError: The network has no such stream, or the weights cannot be read, are of another
            task, or hold no such stream or one of another size.
    """
    for sensor, source in sources.items():
        if sensor not in network.streams:
            raise ValueError(
                f"initial_streams names {sensor}, but the network's streams are "
                f"{', '.join(network.streams)}; name those"
            )
        weights = read_weights(source)
        if weights.task != task_name:
            raise ValueError(
                f"{source} is of task {weights.task}, expected {task_name}; name another"
            )
        parts = [("stream", network.streams[sensor], "streams")]
        if network.mixes_heads:
            parts.append(("head", network.auxiliary[sensor], "heads"))
        for part, filled, group in parts:
            try:
                fill_network(filled, _within(weights.tensors, f"{group}.{sensor}."))
            except ValueError as error:
                raise ValueError(
                    f"{source} has no {part} {sensor} that fits the network's ({error}); name "
                    f"weights of a network with the same {part}"
                ) from error


def _within(tensors: Mapping[str, Tensor], start: str) -> dict[str, Tensor]:
    """The tensors of one part, by their names in it."""
    return {
        name.removeprefix(start): tensor
        for name, tensor in tensors.items()
        if name.startswith(start)
    }

"""Initialisation of streams from one-sensor networks, for training their fusion."""

from collections.abc import Mapping
from pathlib import Path

from torch import Tensor

from sightline.detection2d.model import Detector
from sightline.files.weights import fill_network, read_weights


def load_stream_weights(network: Detector, sources: Mapping[str, Path], *, task_name: str) -> None:
    """Copy the weights of streams from other networks to the streams of the same name.

    A stream's own head, if it is used at inference (`CompactConfig.own_heads`), is copied too.

    Args:
        network: Network to change; its other weights stay.
        sources: Name of shipped weights, file or checkpoint for each stream (camera, lidar or
            both).
        task_name: Task that the weights must be for.

    Raises:
        ValueError: The network has no such stream, or the weights cannot be read, are for another
            task, or contain no such stream or one of another size.
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
    """Select the tensors of one part, by their names in it."""
    return {
        name.removeprefix(start): tensor
        for name, tensor in tensors.items()
        if name.startswith(start)
    }

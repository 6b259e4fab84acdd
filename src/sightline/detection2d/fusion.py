"""Outputs of the detectors' heads and gates, and the fusion of both sensors by gates."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn


class HeadOutput(NamedTuple):
    """Output of one head for all places of all its maps."""

    class_logits: Float[Tensor, "batch places values"]
    box_logits: Float[Tensor, "batch places box_values"]
    places: Float[Tensor, "places 4"]
    """Centre x, y, width and height [px] of each place: a prior, or a cell of a map."""


class GateOutput(NamedTuple):
    """Logits of the gates for each sensor's features at one map."""

    camera_logits: Float[Tensor, "batch groups rows columns"]
    lidar_logits: Float[Tensor, "batch groups rows columns"]


class RawOutputs(NamedTuple):
    """Outputs of a detector's heads and gates."""

    heads: tuple[HeadOutput, ...]
    """One head; in late fusion one for the camera and one for the LiDAR."""
    gates: tuple[GateOutput, ...]
    """Gates of each map, the finest first; empty without gates."""
    auxiliary: dict[str, HeadOutput]
    """Outputs of the single streams' heads, by sensor."""


class DetectorOutput(NamedTuple):
    """Box of every place, and the gates of the finest map."""

    scores: Float[Tensor, "batch places classes"]
    """Probabilities of the classes."""
    boxes: Float[Tensor, "batch places 4"]
    """x_min, y_min, x_max, y_max in pixels of the input; may reach beyond it."""
    camera_gate: Float[Tensor, "batch groups rows columns"] | None
    """Camera gate, from 0 (its features are not used) to 1; None without gates."""
    lidar_gate: Float[Tensor, "batch groups rows columns"] | None


_KERNEL_PX = 3


class GatedFusion(nn.Module):
    """Weighting of two sensors' feature maps pixel by pixel, and their mixing: eq. 5 to 9.

    Both gates take the maps of both sensors. Without gates the weights are 1, which is the paper's
    "without GFU"; concatenation and mixing stay.

    Args:
        channels: Channels of the camera's and of the LiDAR's map.
        mix: Makes the joint map from the weighted maps, the LiDAR's first: the paper's is a 1x1
            convolution and a ReLU.
        gated: Whether there are gates.
        groups: Number of channel groups with a gate of their own; the paper has one. It must divide
            the channels.
    """

    def __init__(
        self, channels: tuple[int, int], mix: nn.Module, *, gated: bool, groups: int = 1
    ) -> None:
        super().__init__()
        if any(count % groups for count in channels):
            raise ValueError(
                f"gate_groups must divide the channels of both sensors' maps, got {groups} for "
                f"{channels[0]} and {channels[1]}"
            )
        self.camera_gate = self._gate(sum(channels), groups) if gated else None
        self.lidar_gate = self._gate(sum(channels), groups) if gated else None
        self.mix = mix

    @staticmethod
    def _gate(in_channels: int, groups: int) -> nn.Conv2d:
        # Both gates start at one half everywhere. The maps are long and positive, so that a common
        # step of all weights moves every gate: recipes lower the gates' rate (`rate_factors`).
        conv = nn.Conv2d(in_channels, groups, _KERNEL_PX, padding=_KERNEL_PX // 2)
        nn.init.zeros_(conv.weight)
        assert conv.bias is not None, "it has one by default"
        nn.init.zeros_(conv.bias)
        return conv

    def forward(
        self,
        camera: Float[Tensor, "batch camera_channels rows columns"],
        lidar: Float[Tensor, "batch lidar_channels rows columns"],
    ) -> tuple[Float[Tensor, "batch out_channels rows columns"], GateOutput | None]:
        """Compute the joint map and the gates."""
        both = torch.cat((lidar, camera), dim=1)
        if self.camera_gate is None or self.lidar_gate is None:
            return self.mix(both), None
        gates = GateOutput(self.camera_gate(both), self.lidar_gate(both))
        weighted = (_weighted(lidar, gates.lidar_logits), _weighted(camera, gates.camera_logits))
        return self.mix(torch.cat(weighted, dim=1)), gates


def _weighted(
    maps: Float[Tensor, "batch channels rows columns"],
    logits: Float[Tensor, "batch groups rows columns"],
) -> Float[Tensor, "batch channels rows columns"]:
    """Multiply each group of adjacent channels by its gate."""
    each = maps.shape[1] // logits.shape[1]
    return maps * logits.sigmoid().repeat_interleave(each, dim=1)


_MIN_GATE = 1e-3  # so that two closed gates have equal weights, free of rounding errors


def mix_heads(
    joint: HeadOutput, camera: HeadOutput, lidar: HeadOutput, gates: Sequence[GateOutput]
) -> HeadOutput:
    """Average the sensors' own heads, weighted by their gates, and add the joint head.

    If one gate is closed, the other sensor's head has the full weight: a detector that has lost a
    sensor behaves like one that never had it. The joint head adds the information of both sensors
    together.

    Args:
        joint: Output of the head on the fused maps, before the sigmoid.
        camera: Output of the camera stream's own head for the same places.
        lidar: Output of the LiDAR stream's own head.
        gates: Gates of each map, the finest first; none: both sensors have equal weights.
    """
    if gates:
        weights = [
            torch.cat([_mean_gates(logits) for logits in each], dim=1).clamp(min=_MIN_GATE)
            for each in zip(*gates, strict=True)
        ]
        camera_share = weights[0] / (weights[0] + weights[1])
    else:
        camera_share = camera.class_logits.new_full(camera.class_logits.shape[:2], 0.5)
    share = camera_share[:, :, None]
    classes, boxes = (
        own + share * camera_part + (1 - share) * lidar_part
        for own, camera_part, lidar_part in zip(joint[:2], camera[:2], lidar[:2], strict=True)
    )
    return HeadOutput(class_logits=classes, box_logits=boxes, places=joint.places)


def _mean_gates(logits: Tensor) -> Tensor:
    """Compute the mean gate of each of a map's places, row by row."""
    return logits.float().sigmoid().mean(dim=1).flatten(1)

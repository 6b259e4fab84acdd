"""The gated fusion unit: Kim et al. 2018, section III-C."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from sightline.detection2d.readings import GateReading

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
    ) -> tuple[Float[Tensor, "batch out_channels rows columns"], GateReading | None]:
        """Compute the joint map and the gates."""
        both = torch.cat((lidar, camera), dim=1)
        if self.camera_gate is None or self.lidar_gate is None:
            return self.mix(both), None
        gates = GateReading(self.camera_gate(both), self.lidar_gate(both))
        weighted = (_weighted(lidar, gates.lidar_logits), _weighted(camera, gates.camera_logits))
        return self.mix(torch.cat(weighted, dim=1)), gates


def _weighted(
    maps: Float[Tensor, "batch channels rows columns"],
    logits: Float[Tensor, "batch groups rows columns"],
) -> Float[Tensor, "batch channels rows columns"]:
    """Multiply each group of adjacent channels by its gate."""
    each = maps.shape[1] // logits.shape[1]
    return maps * logits.sigmoid().repeat_interleave(each, dim=1)

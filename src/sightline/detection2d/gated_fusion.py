"""The gated fusion unit: Kim et al. 2018, section III-C."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from sightline.detection2d.initialization import start_small
from sightline.detection2d.readings import GateReading

_KERNEL_PX = 3


class GatedFusion(nn.Module):
    """Weighs the feature maps of two sensors pixel by pixel, then mixes them: eq. 5 to 9.

    Both gates see the maps of both sensors. Without gates the weights are 1, which is the paper's
    "without GFU"; concatenation and 1x1 convolution stay.

    Args:
        camera_channels: Of the camera's map.
        lidar_channels: Of the LiDAR's map.
        out_channels: Of the joint map.
        gated: Whether there are gates.
    """

    def __init__(
        self, camera_channels: int, lidar_channels: int, out_channels: int, *, gated: bool
    ) -> None:
        super().__init__()
        both = camera_channels + lidar_channels
        self.camera_gate = self._gate(both) if gated else None
        self.lidar_gate = self._gate(both) if gated else None
        self.mix = start_small(nn.Conv2d(both, out_channels, 1))

    @staticmethod
    def _gate(in_channels: int) -> nn.Conv2d:
        # With a bias of 0 both sensors start at a half.
        return start_small(nn.Conv2d(in_channels, 1, _KERNEL_PX, padding=_KERNEL_PX // 2))

    def forward(
        self,
        camera: Float[Tensor, "batch camera_channels rows columns"],
        lidar: Float[Tensor, "batch lidar_channels rows columns"],
    ) -> tuple[Float[Tensor, "batch out_channels rows columns"], GateReading | None]:
        """The joint map, and what the gates say."""
        if self.camera_gate is None or self.lidar_gate is None:
            return self.mix(torch.cat((lidar, camera), dim=1)).relu(), None
        both = torch.cat((lidar, camera), dim=1)
        gates = GateReading(self.camera_gate(both), self.lidar_gate(both))
        weighted = (lidar * gates.lidar_logits.sigmoid(), camera * gates.camera_logits.sigmoid())
        return self.mix(torch.cat(weighted, dim=1)).relu(), gates

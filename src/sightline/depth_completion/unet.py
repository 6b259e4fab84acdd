"""U-Net: a residual stream down to small maps, and a way back up with the maps beside it."""

from pathlib import Path
from typing import Final

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from sightline.depth_completion.config import UNET_OUTPUT_STRIDE, UNetConfig
from sightline.files.weights import fill_network, read_weights
from sightline.networks.residual import ConvNorm, ResidualStream

IMAGE_PLANES: Final = 3
"""Number of planes of the image, which are the first inputs."""
_DETECTOR, _DETECTOR_STREAM = "detection2d", "streams.camera."
_DETECTOR_SCALE = 4.0  # its images are centred at zero and go from -2 to 2, ours from -0.5 to 0.5
_FIRST = "stem.0.weight"


class UNet(nn.Module):
    """U-Net after Ronneberger et al. 2015, with the mean features of the frame at the bottom.

    The way down is a stream as in the image detector, whose weights it can start from. Outputs are
    predicted at a quarter of the resolution, in blocks of pixels folded into channels.
    """

    def __init__(self, in_channels: int, out_channels: int, config: UNetConfig) -> None:
        super().__init__()
        down, up = config.channels[1:], config.up_channels
        self.down = ResidualStream(in_channels, config.channels, config.blocks, num_maps=len(down))
        self.bottom = ConvNorm(down[-1], up[-1])
        self.up = nn.ModuleList(
            ConvNorm(up[scale + 1] + down[scale], up[scale])
            for scale in reversed(range(len(up) - 1))
        )
        self.head = nn.Conv2d(up[0], out_channels * UNET_OUTPUT_STRIDE**2, kernel_size=3, padding=1)

    def forward(
        self, planes: Float[Tensor, "batch in_channels height width"]
    ) -> Float[Tensor, "batch out_channels height width"]:
        """Run the network; height and width must be multiples of the config's `stride`."""
        *beside, deepest = self.down(planes)
        rising = self.bottom(deepest + deepest.mean(dim=(2, 3), keepdim=True))
        for up, finer in zip(self.up, reversed(beside), strict=True):
            larger = F.interpolate(rising, scale_factor=2.0, mode="nearest")
            rising = up(torch.cat((larger, finer), dim=1))
        return F.pixel_shuffle(self.head(rising), UNET_OUTPUT_STRIDE)


def start_from_detector(network: UNet, source: Path) -> None:
    """Start the way down from the camera stream of an image detector.

    That stream has seen the image alone; weights of the other planes start at zero.

    Args:
        network: Network whose weights are replaced.
        source: Name of shipped weights, file or checkpoint of a detector of the compact design.

    Raises:
        ValueError: The file is none of such a detector, or its stream has other sizes.
    """
    weights = read_weights(source)
    stream = {
        name.removeprefix(_DETECTOR_STREAM): tensor
        for name, tensor in weights.tensors.items()
        if name.startswith(_DETECTOR_STREAM)
    }
    first = stream.get(_FIRST)
    if weights.task != _DETECTOR or first is None or first.shape[1:2] != (IMAGE_PLANES,):
        raise ValueError(
            f"{source} holds no camera stream of an image detector; name one, such as "
            "detection2d-best"
        )
    planes = network.down.state_dict()[_FIRST].shape[1]
    others = first.new_zeros(len(first), planes - IMAGE_PLANES, *first.shape[2:])
    stream[_FIRST] = torch.cat((_DETECTOR_SCALE * first, others), dim=1)
    try:
        fill_network(network.down, stream)
    except ValueError as error:
        raise ValueError(
            f"the camera stream of {source} differs from the network's way down ({error}); set "
            "network.unet.channels and network.unet.blocks to the detector's"
        ) from error

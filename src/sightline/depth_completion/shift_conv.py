"""Shift-Convolution: sparse depth spread over the image, one neighbour at a time."""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from sightline.depth_completion.config import TAPS, ShiftConvConfig


class ShiftConv(nn.Module):
    """Translation of the channels in nine directions, then mixing by a 1x1 convolution: eq. 2.

    Channel c belongs to group c % 9. Group k reads the pixel k // 3 - 1 rows below and k % 3 - 1
    columns to the right, times `shift_px`: the taps of a 3x3 kernel in order, so group 4 stays.
    Values from outside are zero. On nine copies of a map this is a 3x3 convolution.

    The translations are one depthwise convolution whose fixed kernels contain a single 1: on a CPU
    it takes half the time of slicing and concatenating, and every engine supports it.
    """

    shift_kernels: Tensor

    def __init__(
        self, in_channels: int, out_channels: int, shift_px: int = 1, *, norm: bool = True
    ) -> None:
        super().__init__()
        if in_channels < TAPS or in_channels % TAPS:
            raise ValueError(
                f"in_channels must be a multiple of 9, one group per direction, got {in_channels}"
            )
        if shift_px < 1:
            raise ValueError(f"shift_px must be at least 1, got {shift_px}")
        self.shift_px = shift_px
        kernels = torch.eye(TAPS).repeat(in_channels // TAPS, 1).reshape(-1, 1, 3, 3)
        self.register_buffer("shift_kernels", kernels, persistent=False)
        self.mix = nn.Conv2d(in_channels, out_channels, kernel_size=1, bias=not norm)
        self.activate = (
            nn.Sequential(nn.BatchNorm2d(out_channels), nn.ReLU(inplace=True))
            if norm
            else nn.Identity()
        )

    def forward(
        self, maps: Float[Tensor, "batch in_channels height width"]
    ) -> Float[Tensor, "batch out_channels height width"]:
        """Shift, mix, and with `norm` apply BatchNorm and ReLU."""
        shift = self.shift_px
        if maps.is_cuda:  # depthwise convolutions took most of a training there
            shifted = translate(maps, shift)
        else:
            kernels = self.shift_kernels.to(maps.dtype)
            shifted = F.conv2d(
                maps, kernels, padding=shift, dilation=shift, groups=self.mix.in_channels
            )
        mixed: Tensor = self.activate(self.mix(shifted))
        return mixed


def translate(
    maps: Float[Tensor, "batch channels height width"], shift_px: int
) -> Float[Tensor, "batch channels height width"]:
    """Translate the channels as `ShiftConv` does, by slices of the padded map."""
    height, width = maps.shape[2:]
    padded = F.pad(maps, (shift_px,) * 4)
    groups = []
    for direction in range(TAPS):
        top, left = (shift_px * place for place in divmod(direction, 3))
        groups.append(padded[:, direction::TAPS, top : top + height, left : left + width])
    return torch.stack(groups, dim=2).flatten(1, 2)


class ShiftConvBranch(nn.Module):
    """Conversion of sparse depth to a filled depth map, the E-Point: section 3.1, Fig. 6.

    A 1x1 convolution, the Shift-Convolutions and a linear 1x1 convolution to depth. Units are the
    input's; the result is not clamped.
    """

    def __init__(self, in_channels: int, config: ShiftConvConfig) -> None:
        super().__init__()
        cells = config.stride**2
        self.stride = config.stride
        self.lift = nn.Conv2d(in_channels * cells, config.channels, kernel_size=1)
        shifts_px = config.shifts_px
        self.layers = nn.Sequential(
            *(
                ShiftConv(config.channels, config.channels, shifts_px[layer % len(shifts_px)])
                for layer in range(config.layers)
            )
        )
        self.read = nn.Conv2d(config.channels, cells, kernel_size=1)

    def forward(
        self, depth: Float[Tensor, "batch in_channels height width"]
    ) -> Float[Tensor, "batch 1 height width"]:
        """Fill the map; height and width must be multiples of the config's `stride`."""
        lifted = self.lift(F.pixel_unshuffle(depth, self.stride))
        return F.pixel_shuffle(self.read(self.layers(lifted)), self.stride)

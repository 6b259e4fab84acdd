"""A small network with everything in it that a task's network may have."""

from collections.abc import Mapping
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from sightline.export.metadata import ExportMetadata

STRIDE = 8
METADATA = ExportMetadata(
    task="toy",
    config={"channels": 9, "shifts": [1, 2], "note": 'quotes "<&> and Umlaute äöü'},
    stride=STRIDE,
    provenance={"seed": "0"},
    processing={"classes": ["Car"], "padding": {"sides": ["right"], "value": 0.5}},
)


class ToyOutput(NamedTuple):
    depth_m: Tensor
    uncertainty_m: Tensor | None
    e_point_m: Tensor | None


class ToyNetwork(nn.Module):
    """Shifts, strides, nearest and shuffled upsampling, batch norm, a switch on a black image."""

    def __init__(self, generator: torch.Generator) -> None:
        super().__init__()
        self.lift = nn.Conv2d(4, 9, 1)
        self.mix = nn.Conv2d(27, 9, 1)
        self.norm = nn.BatchNorm2d(9)
        self.down = nn.Sequential(*(nn.Conv2d(9, 9, 3, stride=2, padding=1) for _ in range(3)))
        self.fold = nn.Conv2d(9, 4, 3, padding=1)
        self.head = nn.Conv2d(9, 1, 3, padding=1)
        with torch.no_grad():
            for tensor in (*self.parameters(), self.norm.running_mean):
                tensor.copy_(0.5 * torch.rand(tensor.shape, generator=generator) - 0.25)
            self.norm.running_var.uniform_(0.5, 2, generator=generator)
        self.eval()

    def forward(
        self, image: Tensor, sparse_depth_m: Tensor, filled_depth_m: Tensor | None = None
    ) -> ToyOutput:
        assert filled_depth_m is None
        present = (image.amax(dim=(1, 2, 3), keepdim=True) > 0).to(image.dtype)
        lifted = self.lift(torch.cat(((image - 0.5) * present, sparse_depth_m / 85), dim=1))
        height, width = lifted.shape[-2:]
        padded = functional.pad(lifted, (1, 1, 1, 1))
        shifted = [padded[:, :, tap : tap + height, tap : tap + width] for tap in range(3)]
        mixed = self.norm(self.mix(torch.cat(shifted, dim=1))).relu()
        low = functional.interpolate(self.down(mixed), scale_factor=4, mode="nearest")
        e_point = functional.pixel_shuffle(self.fold(low), 2)
        return ToyOutput(85 * (self.head(mixed) + e_point), None, 85 * e_point)


def toy_network() -> ToyNetwork:
    return ToyNetwork(torch.Generator().manual_seed(0))


def toy_inputs(height: int, width: int, *, seed: int = 0) -> Mapping[str, Tensor]:
    generator = torch.Generator().manual_seed(seed)
    return {
        "image": torch.rand(1, 3, height, width, generator=generator),
        "sparse_depth_m": 85 * torch.rand(1, 1, height, width, generator=generator),
    }

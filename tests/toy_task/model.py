"""Network of two modules, which are exported as two graphs."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from tests.toy_task.config import FinderConfig


class FinderOutput(NamedTuple):
    """Output of the second stage."""

    logits: Float[Tensor, "batch 1 rows columns"]


class Features(nn.Module):
    """First stage: features of cells."""

    def __init__(self, config: FinderConfig) -> None:
        super().__init__()
        cell = config.cell_px
        self.fold = nn.Conv2d(4, config.channels, cell, stride=cell)

    def forward(
        self,
        image: Float[Tensor, "batch 3 height width"],
        sparse_depth_m: Float[Tensor, "batch 1 height width"],
    ) -> Float[Tensor, "batch channels rows columns"]:
        return self.fold(torch.cat((image, sparse_depth_m / 80), dim=1)).relu()


class Likelihood(nn.Module):
    """Second stage: likelihood in each cell."""

    def __init__(self, config: FinderConfig) -> None:
        super().__init__()
        self.read = nn.Conv2d(config.channels, 1, 1)

    def forward(self, features: Float[Tensor, "batch channels rows columns"]) -> FinderOutput:
        return FinderOutput(self.read(features))


class FinderNet(nn.Module):
    """Both stages."""

    def __init__(self, config: FinderConfig) -> None:
        super().__init__()
        self.config = config
        self.features = Features(config)
        self.likelihood = Likelihood(config)

    def forward(self, image: Tensor, sparse_depth_m: Tensor) -> FinderOutput:
        return self.likelihood(self.features(image, sparse_depth_m))

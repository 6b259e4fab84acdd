"""Tiny networks with random weights, as files, for the tests of this folder."""

from dataclasses import asdict
from pathlib import Path

import torch

from sightline.depth_completion.config import DepthCompletionConfig, ShiftConvConfig, TrunkConfig
from sightline.depth_completion.model import DepthCompletionNet
from sightline.files.weights import write_weights

TINY = {
    "shift_conv": ShiftConvConfig(channels=9, layers=1),
    "trunk": TrunkConfig(channels=(4, 8), modules=1, blocks=1),
    "stem_channels": 4,
}


def tiny_config(**settings) -> DepthCompletionConfig:
    """Settings of a network of stride 2 with a few thousand weights."""
    return DepthCompletionConfig(**{**TINY, **settings})


def write_tiny_weights(path: Path, *, seed: int = 0, task: str = "depth-completion", **settings):
    """Write random weights; returns the path."""
    config = tiny_config(**settings)
    network = DepthCompletionNet(config)
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.copy_(0.3 * torch.randn(parameter.shape, generator=generator))
    write_weights(
        path,
        network.state_dict(),
        task=task,
        config=asdict(config),
        provenance={"sightline": "0.0.1"},
    )
    return path

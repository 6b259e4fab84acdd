"""Settings and constructor for loading a depth completion network."""

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from sightline.depth_completion.config import DepthCompletionConfig
    from sightline.depth_completion.model import DepthCompletionNet


IMAGE_WEIGHTS: Final = "depth-image"
"""Shipped weights that guess depth from the image, for frames without returns."""


class DepthNetworkTask:
    """`sightline.inference.network.NetworkTask` that imports the network when it builds it."""

    name: Final = "depth-completion"
    default_weights: Final = "depth-best"

    def config_type(self) -> "type[DepthCompletionConfig]":
        """Class of the network's settings."""
        from sightline.depth_completion.config import DepthCompletionConfig

        return DepthCompletionConfig

    def build(self, config: "DepthCompletionConfig") -> "DepthCompletionNet":
        """Build the network."""
        from sightline.depth_completion.model import DepthCompletionNet

        return DepthCompletionNet(config)


NETWORK_TASK: Final = DepthNetworkTask()

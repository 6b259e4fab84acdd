"""Loader of 2D detection networks."""

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from sightline.detection2d.config import Detection2DConfig
    from sightline.detection2d.model import Detector


class DetectionNetworkTask:
    """`sightline.inference.network.NetworkTask` that imports the network when it builds it."""

    name: Final = "detection2d"

    def config_type(self) -> "type[Detection2DConfig]":
        """Return the type of the network's settings."""
        from sightline.detection2d.config import Detection2DConfig

        return Detection2DConfig

    def build(self, config: "Detection2DConfig") -> "Detector":
        """Build the network."""
        from sightline.detection2d.model import Detector

        return Detector(config)


NETWORK_TASK: Final = DetectionNetworkTask()

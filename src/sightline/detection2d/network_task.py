"""What loading a 2D detection network requires to know."""

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from sightline.detection2d.config import Detection2DConfig
    from sightline.detection2d.model import Detector


class DetectionNetworkTask:
    """`sightline.inference.network.NetworkTask`; what it builds is imported when it is built."""

    name: Final = "detection2d"

    def config_type(self) -> "type[Detection2DConfig]":
        """The network's settings."""
        from sightline.detection2d.config import Detection2DConfig

        return Detection2DConfig

    def build(self, config: "Detection2DConfig") -> "Detector":
        """The network."""
        from sightline.detection2d.model import Detector

        return Detector(config)


NETWORK_TASK: Final = DetectionNetworkTask()

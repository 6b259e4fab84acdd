"""What loading a 3D detection network requires to know."""

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from sightline.detection3d.detector_config import Detection3DConfig
    from sightline.detection3d.model import Detector3D


class DetectionNetworkTask:
    """`sightline.inference.network.NetworkTask`; what it builds is imported when it is built."""

    name: Final = "detection3d"

    def config_type(self) -> "type[Detection3DConfig]":
        """The network's settings."""
        from sightline.detection3d.detector_config import Detection3DConfig

        return Detection3DConfig

    def build(self, config: "Detection3DConfig") -> "Detector3D":
        """The network."""
        from sightline.detection3d.model import Detector3D

        return Detector3D(config)


NETWORK_TASK: Final = DetectionNetworkTask()

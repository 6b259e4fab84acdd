"""Loader of 3D detection networks."""

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from sightline.detection3d.config import Detection3DConfig
    from sightline.detection3d.detector import Detector3D


class Detection3DNetworkTask:
    """`sightline.inference.network.NetworkTask` that imports the network when it builds it."""

    name: Final = "detection3d"

    def config_type(self) -> "type[Detection3DConfig]":
        """Return the type of the network's settings."""
        from sightline.detection3d.config import Detection3DConfig

        return Detection3DConfig

    def build(self, config: "Detection3DConfig") -> "Detector3D":
        """Build the network."""
        from sightline.detection3d.detector import Detector3D

        return Detector3D(config)


NETWORK_TASK: Final = Detection3DNetworkTask()

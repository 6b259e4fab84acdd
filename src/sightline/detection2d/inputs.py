"""Preparation of the sensors' images for the streams."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

_RGB_MEANS = (0.48235, 0.45882, 0.40784)  # ImageNet's, subtracted in VGG16's training


class CompactInput(nn.Module):
    """Images of both sensors, centred at zero; all zero if a sensor is missing."""

    camera_planes, lidar_planes = 3, 4

    def camera(
        self, image: Float[Tensor, "batch 3 height width"]
    ) -> Float[Tensor, "batch 3 height width"]:
        """Convert RGB in [0, 1] to planes."""
        is_there = (image.amax(dim=(1, 2, 3), keepdim=True) > 0).to(image.dtype)
        return 4 * (image - 0.5) * is_there

    def lidar(
        self, image: Float[Tensor, "batch 3 height width"]
    ) -> Float[Tensor, "batch 4 height width"]:
        """Convert depth, height and intensity in [0, 1] to planes, and add a mask of points.

        All values are largest for near, low and dark points, so that the maximum is a useful
        summary of several pixels.
        """
        has_point = (image.amax(dim=1, keepdim=True) > 0).to(image.dtype)
        return torch.cat((2 * image, has_point), dim=1)


class VggInput(nn.Module):
    """Images of both sensors, given in [0, 1], scaled to the range of VGG16's pretraining.

    Planes are 255 times as large, RGB minus its means.

    Kim et al. 2018 do not specify this. The LiDAR's image is not shifted, so that pixels without a
    point are 0; a black camera image is -mean, as from a dead camera.
    """

    camera_planes, lidar_planes = 3, 3
    means: Tensor

    def __init__(self) -> None:
        super().__init__()
        means = torch.tensor(_RGB_MEANS)[:, None, None]
        self.register_buffer("means", means, persistent=False)

    def camera(
        self, image: Float[Tensor, "batch 3 height width"]
    ) -> Float[Tensor, "batch 3 height width"]:
        """Convert RGB in [0, 1] to planes."""
        return 255 * (image - self.means)

    def lidar(
        self, image: Float[Tensor, "batch 3 height width"]
    ) -> Float[Tensor, "batch 3 height width"]:
        """Convert depth, height and intensity in [0, 1] to planes."""
        return 255 * image

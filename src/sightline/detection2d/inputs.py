"""Images of the sensors as the streams take them."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

_RGB_MEANS = (0.48235, 0.45882, 0.40784)  # ImageNet's, about which VGG16 was trained


class CompactInput(nn.Module):
    """Both sensors' images about zero, and zero throughout where a sensor delivered nothing."""

    camera_planes, lidar_planes = 3, 4

    def camera(
        self, image: Float[Tensor, "batch 3 height width"]
    ) -> Float[Tensor, "batch 3 height width"]:
        """RGB in [0, 1] to planes."""
        is_there = (image.amax(dim=(1, 2, 3), keepdim=True) > 0).to(image.dtype)
        return 4 * (image - 0.5) * is_there

    def lidar(
        self, image: Float[Tensor, "batch 3 height width"]
    ) -> Float[Tensor, "batch 4 height width"]:
        """Depth, height and intensity in [0, 1] to planes, and whether there is a point.

        All are largest for what is near, low and dark, so that of several pixels the maximum is a
        sensible summary.
        """
        has_point = (image.amax(dim=1, keepdim=True) > 0).to(image.dtype)
        return torch.cat((2 * image, has_point), dim=1)


class VggInput(nn.Module):
    """Both sensors' images, given in [0, 1], in the range of VGG16's first training.

    Planes are 255 times as large, RGB about its means.

    Kim et al. 2018 say nothing of it; the LiDAR's image stays as it is, so that pixels without a
    point are 0, and a black camera image is -mean, as a dead camera would deliver it.
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
        """RGB in [0, 1] to planes."""
        return 255 * (image - self.means)

    def lidar(
        self, image: Float[Tensor, "batch 3 height width"]
    ) -> Float[Tensor, "batch 3 height width"]:
        """Depth, height and intensity in [0, 1] to planes."""
        return 255 * image

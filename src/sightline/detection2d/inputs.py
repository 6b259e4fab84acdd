"""Images of the sensors as the streams take them."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

_RGB_MEANS = (0.48235, 0.45882, 0.40784)  # of ImageNet, as VGG16 was trained with


class VggInput(nn.Module):
    """Both sensors' images in the range of VGG16's first training: 0 to 255, RGB about its means.

    Kim et al. 2018 say nothing of it; the LiDAR's image stays as it is, so that pixels without a
    point are 0, and a black camera image is -mean, as a dead camera would deliver it.
    """

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

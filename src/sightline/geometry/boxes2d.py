"""Axis-aligned boxes in the image."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from sightline.geometry.checked import checked
from sightline.geometry.given_arrays import Rows, selected_rows


@checked()
@dataclass(frozen=True, slots=True)
class Boxes2D:
    """Boxes in pixels: x_min, y_min, x_max, y_max.

    Pixel (0, 0) is the centre of the top-left pixel. A box is a region of the plane, so its area
    is width times height without "+ 1" (KITTI's evaluator has its own rule, and follows it there).

    Examples:
        >>> import torch
        >>> from sightline import Boxes2D
        >>> boxes = Boxes2D(torch.tensor([[10.0, 20.0, 60.0, 50.0], [-5.0, 0.0, 5.0, 10.0]]))
        >>> boxes.area().tolist(), boxes.clip((40, 50)).tensor[1].tolist()
        ([1500.0, 100.0], [0.0, 0.0, 5.0, 10.0])
    """

    tensor: Float[Tensor, "*batch num_boxes 4"]

    def __len__(self) -> int:
        """Number of boxes (of each batch entry)."""
        return self.tensor.shape[-2]

    def __getitem__(self, index: Rows) -> "Boxes2D":
        """Select boxes of an unbatched set, by indices, mask or slice; one by its number."""
        return Boxes2D(self.tensor[selected_rows(index, len(self.tensor))])

    def __iter__(self) -> Iterator[Float[Tensor, "4"]]:
        """Yield the numbers of each box of an unbatched set."""
        return iter(self.tensor)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:  # noqa: ANN401, FBT001
        """Convert to an array, on the CPU."""
        return np.array(self.tensor.detach().cpu().numpy(), dtype, copy=copy)

    def to(self, device: torch.device | str) -> "Boxes2D":
        """Return the boxes on another device."""
        return Boxes2D(self.tensor.to(device))

    def sizes(self) -> Float[Tensor, "*batch num_boxes 2"]:
        """Compute width and height [px]; an inverted box has size zero."""
        return (self.tensor[..., 2:] - self.tensor[..., :2]).clamp(min=0)

    def area(self) -> Float[Tensor, "*batch num_boxes"]:
        """Compute width times height [px^2], at least in float32: float16 ends at 256 by 256 px."""
        return _at_least_float32(self.sizes()).prod(dim=-1)

    def clip(self, image_size: tuple[int, int]) -> "Boxes2D":
        """Clip to the pixel centres of an image of (height, width), as KITTI does."""
        height, width = image_size
        limit = self.tensor.new_tensor([width - 1, height - 1, width - 1, height - 1])
        return Boxes2D(torch.minimum(self.tensor.clamp(min=0), limit))

    def resize(self, scale_x: float, scale_y: float) -> "Boxes2D":
        """Scale the boxes with the image; pixels are squares around their centres."""
        scales = self.tensor.new_tensor((scale_x, scale_y) * 2)
        return Boxes2D((self.tensor + 0.5) * scales - 0.5)


def pairwise_iou2d(a: Boxes2D, b: Boxes2D) -> Float[Tensor, "*batch num_a num_b"]:
    """IoU of every box of `a` with every box of `b`; 0 if both are empty."""
    lower = torch.maximum(a.tensor[..., :, None, :2], b.tensor[..., None, :, :2])
    upper = torch.minimum(a.tensor[..., :, None, 2:], b.tensor[..., None, :, 2:])
    intersection = _at_least_float32(upper - lower).clamp(min=0).prod(dim=-1)
    union = a.area()[..., :, None] + b.area()[..., None, :] - intersection
    return torch.where(union > 0, intersection / union.where(union > 0, 1.0), 0.0)


def _at_least_float32(tensor: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    return tensor.to(torch.promote_types(tensor.dtype, torch.float32))

"""SSD's prior boxes in pixels, and box offsets from priors."""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

_CENTER_VARIANCE, _SIZE_VARIANCE = 0.1, 0.2  # SSD's divisors of the offsets
_LARGEST_LOG_SIZE = math.log(1000.0)  # keeps boxes of untrained networks finite


def prior_shapes(
    sizes_px: Sequence[float], ratios: Sequence[Sequence[float]]
) -> list[list[tuple[float, float]]]:
    """Compute width and height [px] of each prior of each map: Liu et al. 2016, section 2.2.

    The order is that of SSD's own program: the square of the map's size, the square of the
    geometric mean with the next size, then each ratio lying and upright. Sizes stay those of
    SSD300, in pixels: scaled to an image three times as wide as high, upright priors would be lost,
    and pedestrians with them.
    """
    shapes = []
    for size, following, map_ratios in zip(sizes_px, sizes_px[1:], ratios, strict=False):
        mean = math.sqrt(size * following)
        boxes = [(size, size), (mean, mean)]
        for ratio in map_ratios:
            root = math.sqrt(ratio)
            boxes += [(size * root, size / root), (size / root, size * root)]
        shapes.append(boxes)
    return shapes


def make_priors(
    shapes: Sequence[tuple[float, float]],
    rows: int,
    columns: int,
    image_size: tuple[int, int],
    like: Tensor,
) -> Float[Tensor, "places 4"]:
    """Make centre x, y, width, height [px] of the priors of a map: row by row, then by shape.

    The map's cells divide the image evenly. Priors are clipped to it (at the centres of its
    outermost pixels, as labels are).

    Args:
        shapes: Width, height [px] of the priors of each cell.
        rows: Number of rows of the map.
        columns: Number of columns of the map.
        image_size: Height, width [px] of the network's input.
        like: Tensor with the result's device and type.
    """
    height, width = image_size
    y = (torch.arange(rows, device=like.device) + 0.5) * (height / rows) - 0.5
    x = (torch.arange(columns, device=like.device) + 0.5) * (width / columns) - 0.5
    half = torch.tensor(shapes, device=like.device) / 2
    low_x = (x[None, :, None] - half[:, 0]).clamp(min=0).expand(rows, -1, -1)
    high_x = (x[None, :, None] + half[:, 0]).clamp(max=width - 1).expand(rows, -1, -1)
    low_y = (y[:, None, None] - half[:, 1]).clamp(min=0).expand(-1, columns, -1)
    high_y = (y[:, None, None] + half[:, 1]).clamp(max=height - 1).expand(-1, columns, -1)
    bounds = torch.stack(
        ((low_x + high_x) / 2, (low_y + high_y) / 2, high_x - low_x, high_y - low_y), dim=-1
    )
    return bounds.reshape(-1, 4).to(like.dtype)


def corners_of(places: Float[Tensor, "*batch 4"]) -> Float[Tensor, "*batch 4"]:
    """Convert centres and sizes to x_min, y_min, x_max, y_max."""
    centers, sizes = places[..., :2], places[..., 2:]
    return torch.cat((centers - sizes / 2, centers + sizes / 2), dim=-1)


def encode_boxes(
    boxes: Float[Tensor, "num 4"], places: Float[Tensor, "num 4"]
) -> Float[Tensor, "num 4"]:
    """Encode boxes (corners) as offsets from priors (centres and sizes), the network's targets.

    Liu et al. 2016, eq. 2, divided by SSD's variances 0.1 and 0.2.
    """
    sizes = (boxes[:, 2:] - boxes[:, :2]).clamp(min=1e-3)
    centers = (boxes[:, :2] + boxes[:, 2:]) / 2
    moved = (centers - places[:, :2]) / places[:, 2:] / _CENTER_VARIANCE
    return torch.cat((moved, (sizes / places[:, 2:]).log() / _SIZE_VARIANCE), dim=1)


def decode_boxes(
    offsets: Float[Tensor, "batch places 4"], places: Float[Tensor, "places 4"]
) -> Float[Tensor, "batch places 4"]:
    """Decode offsets to corners [px]. Sides are at most 1000 times the prior's."""
    centers = places[:, :2] + offsets[..., :2] * _CENTER_VARIANCE * places[:, 2:]
    sizes = (offsets[..., 2:] * _SIZE_VARIANCE).clamp(max=_LARGEST_LOG_SIZE).exp() * places[:, 2:]
    return torch.cat((centers - sizes / 2, centers + sizes / 2), dim=-1)

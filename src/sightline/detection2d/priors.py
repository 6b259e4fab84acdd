"""SSD's prior boxes in pixels, and boxes as offsets from them."""

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

_CENTER_VARIANCE, _SIZE_VARIANCE = 0.1, 0.2  # SSD's: offsets are divided by them
_LARGEST_LOG_SIZE = math.log(1000.0)  # keeps boxes of untrained networks finite


def prior_shapes(
    sizes_px: Sequence[float], ratios: Sequence[Sequence[float]]
) -> list[list[tuple[float, float]]]:
    """Width and height [px] of each prior of each map: Liu et al. 2016, section 2.2.

    In the order of SSD's own program: the square of the map's size, the square of the geometric
    mean with the next size, then each ratio lying and upright. Sizes stay those of SSD300, in
    pixels: scaled with the sides of an image that is three times as wide as high, upright priors
    would be lost, and pedestrians with them.
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
    """Centre x, y, width, height [px] of the priors of a map: row by row, then by shape.

    The map's cells divide the image evenly, and priors are cut at its border (at the centres of
    its outermost pixels, as labels are).

    Args:
        shapes: Width, height [px] of the priors of each cell.
        rows: Of the map.
        columns: Of the map.
        image_size: Height, width [px] of the network's input.
        like: Gives device and type.
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
    """x_min, y_min, x_max, y_max of centres and sizes."""
    centers, sizes = places[..., :2], places[..., 2:]
    return torch.cat((centers - sizes / 2, centers + sizes / 2), dim=-1)


def encode_boxes(
    boxes: Float[Tensor, "num 4"], places: Float[Tensor, "num 4"]
) -> Float[Tensor, "num 4"]:
    """Offsets of boxes (corners) from priors (centres and sizes), which a network learns.

    Liu et al. 2016, eq. 2, divided by SSD's variances 0.1 and 0.2.
    """
    sizes = (boxes[:, 2:] - boxes[:, :2]).clamp(min=1e-3)
    centers = (boxes[:, :2] + boxes[:, 2:]) / 2
    moved = (centers - places[:, :2]) / places[:, 2:] / _CENTER_VARIANCE
    return torch.cat((moved, (sizes / places[:, 2:]).log() / _SIZE_VARIANCE), dim=1)


def decode_boxes(
    offsets: Float[Tensor, "batch places 4"], places: Float[Tensor, "places 4"]
) -> Float[Tensor, "batch places 4"]:
    """The inverse: corners [px] of boxes. No side gets longer than 1000 times its prior's."""
    centers = places[:, :2] + offsets[..., :2] * _CENTER_VARIANCE * places[:, 2:]
    sizes = (offsets[..., 2:] * _SIZE_VARIANCE).clamp(max=_LARGEST_LOG_SIZE).exp() * places[:, 2:]
    return torch.cat((centers - sizes / 2, centers + sizes / 2), dim=-1)

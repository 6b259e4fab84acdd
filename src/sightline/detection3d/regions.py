"""Input of the compact second stage: points in the frame of each proposal."""

from typing import NamedTuple

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from sightline.detection3d.region_config import RegionConfig
from sightline.ops.roi_points import roi_points

RANGE_SCALE_M = 40.0
REGION_COUNT_SCALE = 0.25  # factor on log(1 + number of points)


class CutRegions(NamedTuple):
    """Network input of the second stage."""

    points: Float[Tensor, "num_regions roi_points point_channels"]
    """Canonical: x, y, z in the proposal's frame [m], the distances to its six faces [m], and
    features; else x, y, z in the sweep's frame and features."""
    context: Float[Tensor, "num_regions context_channels"]
    """Logarithms of the sizes over the class's mean, range, cosine and sine of the bearing in the
    proposal's frame, number of points, and the one-hot class."""


def cut_regions(
    points: Float[Tensor, "num_points 3"],
    features: Float[Tensor, "num_points in_channels"],
    boxes: Float[Tensor, "num_regions 7"],
    classes: Int64[Tensor, " num_regions"],
    config: RegionConfig,
    *,
    seed: int,
) -> CutRegions:
    """Draw points in and around each proposal of a sweep, in its frame if canonical.

    As in Shi et al. 2019 (PointRCNN), section 3.3, the frame's origin is the proposal's centre and
    x its heading. The distances to the faces give the network the proposal's size: Li et al. 2021
    (LiDAR R-CNN; boundary offset). If there are too few points, some are repeated
    (`ops.roi_points`), which does not change their maxima; regions without points are all 0.
    Nothing depends on the direction of the sensor's x axis.

    Args:
        points: LiDAR frame [m].
        features: Features of the points.
        boxes: The proposals: x, y, z, length, width, height, yaw (LiDAR frame, metres, radians).
        classes: Indices into the classes.
        config: Margins, numbers and classes.
        seed: Seed of the draw, which is reproducible.

    Raises:
        ValueError: A coordinate or a box is not finite, a size negative or the seed out of range.
    """
    margin = boxes.new_tensor(config.margin_m)
    around = torch.cat((boxes[:, :3], boxes[:, 3:6] + 2 * margin, boxes[:, 6:]), dim=1)
    drawn = roi_points(points[None], around[None], margin_m=0.0, count=config.num_points, seed=seed)
    index, num_inside = drawn.indices[0], drawn.num_inside[0]
    if len(points) == 0:
        points, features = points.new_zeros(1, 3), features.new_zeros(1, features.shape[1])
    place = points[index]
    if config.canonical:
        place, half = _canonical(place, boxes), boxes[:, None, 3:6] / 2
        place = torch.cat((place, half - place, half + place), dim=2)
    told = torch.cat((place, features[index]), dim=2)
    is_empty = (num_inside == 0)[:, None, None]
    return CutRegions(
        points=torch.where(is_empty, 0.0, told),
        context=_context(boxes, classes, num_inside, config),
    )


def flip_heading(cut: CutRegions) -> CutRegions:
    """Convert canonical regions to those of proposals turned by half a turn."""
    points = cut.points.clone()
    points[..., :2] *= -1
    points[..., [3, 4, 6, 7]] = cut.points[..., [6, 7, 3, 4]]  # faces but top and bottom
    context = cut.context.clone()
    context[:, 4:6] *= -1  # cosine and sine of the bearing
    return CutRegions(points, context)


def _canonical(
    points: Float[Tensor, "num_regions roi_points 3"], boxes: Float[Tensor, "num_regions 7"]
) -> Float[Tensor, "num_regions roi_points 3"]:
    """Transform points into their boxes' frames."""
    x, y, z = (points - boxes[:, None, :3]).unbind(dim=2)
    cos, sin = boxes[:, 6:].cos(), boxes[:, 6:].sin()
    return torch.stack((cos * x + sin * y, cos * y - sin * x, z), dim=2)


def _context(
    boxes: Float[Tensor, "num_regions 7"],
    classes: Int64[Tensor, " num_regions"],
    num_inside: Int64[Tensor, " num_regions"],
    config: RegionConfig,
) -> Float[Tensor, "num_regions context_channels"]:
    mean_sizes = boxes.new_tensor([entry.mean_size_m for entry in config.classes])[classes]
    bearing = torch.atan2(boxes[:, 1], boxes[:, 0]) - boxes[:, 6]
    numbers = (
        boxes[:, :2].norm(dim=1) / RANGE_SCALE_M,
        bearing.cos(),
        bearing.sin(),
        REGION_COUNT_SCALE * torch.log1p(num_inside.to(boxes.dtype)),
    )
    is_class = classes[:, None] == torch.arange(len(config.classes), device=boxes.device)
    sizes = torch.log(boxes[:, 3:6] / mean_sizes)
    return torch.cat((sizes, torch.stack(numbers, dim=1), is_class.to(boxes.dtype)), dim=1)

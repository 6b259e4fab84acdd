"""What the compact second stage sees of a proposal: points in the proposal's own frame."""

from typing import NamedTuple

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from sightline.detection3d.region_config import RegionConfig
from sightline.ops.roi_points import roi_points

RANGE_SCALE_M = 40.0
REGION_COUNT_SCALE = 0.25  # of the logarithm of 1 + the number of points


class CutRegions(NamedTuple):
    """Proposals as the second stage's network takes them."""

    points: Float[Tensor, "num_regions roi_points point_channels"]
    """x, y, z in the proposal's frame [m], the distances to its six faces [m], and features; not
    canonical, x, y, z in the sweep's frame and features."""
    context: Float[Tensor, "num_regions context_channels"]
    """Logarithms of the sizes over the class's mean, range, cosine and sine of the bearing in the
    proposal's frame, number of points, and 1 at the class."""


def cut_regions(
    points: Float[Tensor, "num_points 3"],
    features: Float[Tensor, "num_points in_channels"],
    boxes: Float[Tensor, "num_regions 7"],
    classes: Int64[Tensor, " num_regions"],
    config: RegionConfig,
    *,
    seed: int,
) -> CutRegions:
    """Draws points in and around each proposal of a sweep, and tells them in its frame.

    As in Shi et al. 2019 (PointRCNN), section 3.3, the frame's origin is the proposal's centre and
    x its heading. The distances to the faces tell a network, which else sees points alone, how
    large the proposal is: Li et al. 2021 (LiDAR R-CNN; boundary offset). Fewer points
    than are drawn are repeated (`ops.roi_points`), which their maxima do not notice; of a region
    without points all are 0. Nothing depends on where the sensor's x axis points.

    Args:
        points: LiDAR frame [m].
        features: Of the points.
        boxes: The proposals: x, y, z, length, width, height, yaw (LiDAR frame, metres, radians).
        classes: Their places among the classes.
        config: Margins, numbers and classes.
        seed: Of the draw; the same one draws the same.

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


def turn_cut(cut: CutRegions) -> CutRegions:
    """Canonical regions of proposals whose fronts are at their other ends."""
    points = cut.points.clone()
    points[..., :2] *= -1
    points[..., [3, 4, 6, 7]] = cut.points[..., [6, 7, 3, 4]]  # to all faces but top and bottom
    context = cut.context.clone()
    context[:, 4:6] *= -1  # cosine and sine of the bearing
    return CutRegions(points, context)


def _canonical(
    points: Float[Tensor, "num_regions roi_points 3"], boxes: Float[Tensor, "num_regions 7"]
) -> Float[Tensor, "num_regions roi_points 3"]:
    """Points of each box in its frame."""
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

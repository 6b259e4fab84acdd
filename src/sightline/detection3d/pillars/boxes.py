"""Box encodings of both stages, and the decoding of the first stage's maps.

First stage: a cell encodes the centre's offset from its middle, the height of the centre, the sizes
relative to the class's mean, and the heading in two parts. The axis is the sine and cosine of twice
the yaw, which do not jump where a box looks the same from both ends. The front is the cosine and
sine of the yaw. So an uncertain front does not disturb the axis, and front and back do not cancel
out.

Second stage: centre offsets are shares of the proposal's sizes, sizes are logarithms, and the axis
of the heading is the sine and cosine of twice the turn, so that a turn has one code however it is
wrapped. A separate logit, not an angle, decides whether the front stays at the proposal's end.
"""

import math
from typing import Final, NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from sightline.detection3d.pillars.config import (
    PillarDetectionConfig,
    PillarGridConfig,
    PillarNetworkConfig,
)
from sightline.detection3d.stages import Proposed
from sightline.geometry.boxes3d import Boxes3D
from sightline.geometry.kitti_mount import KITTI_LIDAR_HEIGHT_M
from sightline.geometry.transforms import wrap_angle
from sightline.ops.nms import nms_bev
from sightline.ops.rotated_iou import pairwise_iou_bev

CENTER_VALUES: Final = 11
"""Number of values for each cell and class: x, y and z of the centre [m], logarithms of length,
width and height over the mean, sine and cosine of twice the yaw, cosine and sine of the yaw, and
the logit of the quality."""
AXIS: Final = slice(6, 8)
FRONT: Final = slice(8, 10)
QUALITY: Final = 10
_ASIDE: Final = 1
LARGEST_LOG_SIZE: Final = 1.0  # sizes stay within a factor of e of the mean

REGION_VALUES: Final = 8
"""Number of values for each region: centre (3), sizes (3), sine, and cosine - 1, of 2 x turn."""
CODE_STEP: Final = 0.15  # offset over size, or log size ratio, with code 1
LARGEST_CODE: Final = 5.0  # size limit: a factor of 2.1 from the proposal

WORST_IOU, BEST_IOU = 0.25, 0.75  # IoUs of qualities 0 and 1
QUALITY_FOCUS: Final = 4  # power of the predicted IoU in the weight of a neighbour's box


def cell_middles(cells: Int64[Tensor, "n 2"], grid: PillarGridConfig) -> Float[Tensor, "n 2"]:
    """Compute x and y [m] of the middles of head cells (row, column)."""
    origin = torch.tensor([grid.x_m[0], grid.y_m[0]], device=cells.device)
    return (cells + 0.5) * grid.head_cell_m + origin


def encode_centers(
    boxes: Float[Tensor, "n 7"], middles: Float[Tensor, "n 2"], mean_sizes: Float[Tensor, "n 3"]
) -> Float[Tensor, "n 10"]:
    """Encode each box relative to its cell's middle [m] and its class: all values but the quality.

    Boxes are x, y, z, length, width, height, yaw (LiDAR frame, metres, radians).
    """
    yaw = boxes[:, 6:]
    parts = (
        boxes[:, :2] - middles,
        boxes[:, 2:3] - _mean_height(mean_sizes),
        torch.log(boxes[:, 3:6] / mean_sizes),
        torch.sin(2 * yaw),
        torch.cos(2 * yaw),
        torch.cos(yaw),
        torch.sin(yaw),
    )
    return torch.cat(parts, dim=1)


def decode_centers(
    values: Float[Tensor, "n values"],
    middles: Float[Tensor, "n 2"],
    mean_sizes: Float[Tensor, "n 3"],
) -> Float[Tensor, "n 7"]:
    """Decode boxes from cell values: the inverse of `encode_centers`. Yaws are in [-pi, pi).

    Sizes are limited to a factor of e from the mean.
    """
    center = torch.cat((middles + values[:, :2], values[:, 2:3] + _mean_height(mean_sizes)), dim=1)
    sizes = mean_sizes * values[:, 3:6].clamp(-LARGEST_LOG_SIZE, LARGEST_LOG_SIZE).exp()
    sine, cosine = values[:, AXIS].unbind(dim=1)
    axis = torch.atan2(sine, cosine) / 2
    ahead, aside = values[:, FRONT].unbind(dim=1)
    is_front = ahead * axis.cos() + aside * axis.sin() >= 0
    yaw = wrap_angle(torch.where(is_front, axis, axis + math.pi))
    return torch.cat((center, sizes, yaw[:, None]), dim=1)


def mirror_centers(
    values: Float[Tensor, "batch classes values rows columns"],
) -> Float[Tensor, "batch classes values rows columns"]:
    """Mirror cell values left to right.

    The grid must reach as far to the left as to the right.
    """
    sign = values.new_ones(CENTER_VALUES)
    sign[[_ASIDE, AXIS.start, FRONT.stop - 1]] = -1  # y, the sines of twice the yaw and of the yaw
    return values.flip(-1) * sign[:, None, None]


def _mean_height(mean_sizes: Float[Tensor, "n 3"]) -> Float[Tensor, "n 1"]:
    """Compute z of the centre of a mean-sized box on level ground."""
    return mean_sizes[:, 2:] / 2 - KITTI_LIDAR_HEIGHT_M


class PillarOutput(NamedTuple):
    """Output of the first stage for each cell and class."""

    heat_logits: Float[Tensor, "batch classes rows columns"]
    """Logit that an object's centre is in the cell."""
    center_values: Float[Tensor, "batch classes values rows columns"]
    """Box of a nearby object and its quality; see `CENTER_VALUES`."""


class RegionOutput(NamedTuple):
    """Output of the second stage for each region."""

    values: Float[Tensor, "num_regions 8"]
    """Change of the box; see `encode_regions`."""
    front_logits: Float[Tensor, " num_regions"]
    """Logit that the front stays at the proposal's end."""
    quality_logits: Float[Tensor, " num_regions"]
    """Logit of the quality of the changed box (`quality_from_iou`)."""


def encode_regions(
    boxes: Float[Tensor, "n 7"], proposals: Float[Tensor, "n 7"]
) -> Float[Tensor, "n 8"]:
    """Encode each box relative to its proposal, without the front: `keeps_front`.

    Both are x, y, z, length, width, height, yaw (one frame, metres, radians).
    """
    x, y, z = (boxes[:, :3] - proposals[:, :3]).unbind(dim=1)
    cos, sin = proposals[:, 6].cos(), proposals[:, 6].sin()
    offset = torch.stack((cos * x + sin * y, cos * y - sin * x, z), dim=1)
    turn = 2 * (boxes[:, 6:] - proposals[:, 6:])
    parts = (
        offset / (CODE_STEP * proposals[:, 3:6]),
        torch.log(boxes[:, 3:6] / proposals[:, 3:6]) / CODE_STEP,
        turn.sin(),
        turn.cos() - 1,
    )
    return torch.cat(parts, dim=1)


def turn_regions(values: Float[Tensor, "n 8"]) -> Float[Tensor, "n 8"]:
    """Convert codes to those for proposals turned by half a turn."""
    return values * values.new_tensor([-1, -1, 1, 1, 1, 1, 1, 1])


def keeps_front(boxes: Float[Tensor, "n 7"], proposals: Float[Tensor, "n 7"]) -> Bool[Tensor, " n"]:
    """Mask of the boxes whose front is at the end nearer to the proposal's front."""
    return (boxes[:, 6] - proposals[:, 6]).cos() >= 0


def decode_regions(
    values: Float[Tensor, "n 8"], is_front_kept: Bool[Tensor, " n"], proposals: Float[Tensor, "n 7"]
) -> Float[Tensor, "n 7"]:
    """Decode boxes: the inverse of `encode_regions`. Yaws are in [-pi, pi).

    Zeros leave a proposal unchanged. A size changes by at most a factor of 2.1.
    """
    forwards, leftwards, up = (CODE_STEP * proposals[:, 3:6] * values[:, :3]).unbind(dim=1)
    cos, sin = proposals[:, 6].cos(), proposals[:, 6].sin()
    move = torch.stack((cos * forwards - sin * leftwards, sin * forwards + cos * leftwards, up), 1)
    growth = (CODE_STEP * values[:, 3:6].clamp(-LARGEST_CODE, LARGEST_CODE)).exp()
    turn = torch.atan2(values[:, 6], 1 + values[:, 7]) / 2
    yaw = proposals[:, 6] + turn + torch.where(is_front_kept, 0.0, math.pi)
    return torch.cat(
        (proposals[:, :3] + move, proposals[:, 3:6] * growth, wrap_angle(yaw)[:, None]), dim=1
    )


def quality_from_iou(iou: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Quality target for a 3D IoU: Shi et al. 2020 (PV-RCNN), section 3.3.

    It is 0 up to an IoU of 0.25, 1 from an IoU of 0.75, and linear in between.
    """
    return ((iou - WORST_IOU) / (BEST_IOU - WORST_IOU)).clamp(0, 1)


def iou_from_quality(quality: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Convert a quality to its IoU, from 0.25 to 0.75."""
    return WORST_IOU + (BEST_IOU - WORST_IOU) * quality


def corner_costs(
    predicted: Float[Tensor, "n 7"], target: Float[Tensor, "n 7"], *, knee_m: float
) -> Float[Tensor, " n"]:
    """Smooth L1 [m] of each box's corners, the mean of the eight: Qi et al. 2018 (Frustum), eq. 2.

    The cost is the smaller one of two: for the target, and for the same box facing backwards. Other
    losses teach the front. At an error of `knee_m` it changes from quadratic to linear.
    """
    turn = target.new_tensor([0, 0, 0, 0, 0, 0, math.pi])
    corners = Boxes3D(predicted).corners()
    costs = [
        F.smooth_l1_loss(corners, Boxes3D(each).corners(), reduction="none", beta=knee_m)
        for each in (target, target + turn)
    ]
    forwards, backwards = (cost.sum(dim=2).mean(dim=1) for cost in costs)
    return torch.minimum(forwards, backwards)


def find_boxes(
    output: PillarOutput, sweep: int, network: PillarNetworkConfig, config: PillarDetectionConfig
) -> Proposed:
    """Decode the boxes of one sweep of a batch.

    Cells that are the local maximum of 3x3 cells for their class give a box; non-maximum
    suppression from above removes duplicates. Each remaining box becomes the mean of the boxes of
    all hot cells around it, which is steadier than one cell's box.
    """
    heat = output.heat_logits[sweep].sigmoid()
    cells = (heat >= config.min_heat).nonzero()
    order = heat[tuple(cells.T)].argsort(descending=True, stable=True)[: config.max_cells]
    cells = cells[order]
    of_class, row, column = cells.unbind(dim=1)
    warmth = heat[of_class, row, column]
    values = output.center_values[sweep, of_class, :, row, column]
    mean_sizes = values.new_tensor([entry.mean_size_m for entry in network.classes])
    middles = cell_middles(cells[:, 1:], network.grid).to(values.dtype)
    boxes = decode_centers(values, middles, mean_sizes[of_class])
    iou = iou_from_quality(values[:, QUALITY].sigmoid())
    scores = warmth ** (1 - config.quality_share) * iou**config.quality_share
    is_peak = heat == F.max_pool2d(heat[None], 3, stride=1, padding=1)[0]
    peaks = is_peak[of_class, row, column].nonzero()[:, 0]
    kept = peaks[
        nms_bev(
            Boxes3D(boxes[peaks]).bev,
            scores[peaks],
            config.suppression_iou,
            labels=of_class[peaks],
            max_detections=config.max_boxes,
        )
    ]
    found = Proposed(boxes, of_class, scores)
    if config.mean_iou is None:
        return found.select(kept)
    means = _mean_boxes(found, kept, warmth * iou**QUALITY_FOCUS, config.mean_iou)
    return found.select(kept)._replace(boxes=means)


def _mean_boxes(
    found: Proposed,
    kept: Int64[Tensor, " num_kept"],
    weights: Float[Tensor, " num_proposals"],
    min_iou: float,
) -> Float[Tensor, "num_kept 7"]:
    """Average each kept box with the overlapping boxes of its class, by weight.

    Yaws are averaged as directions relative to the kept box: first the axis, then the front.
    """
    own = found.boxes[kept]
    iou = pairwise_iou_bev(Boxes3D(own).bev, Boxes3D(found.boxes).bev)
    is_around = (iou > min_iou) & (found.classes[kept, None] == found.classes)
    is_around[torch.arange(len(kept), device=kept.device), kept] = True
    weights = torch.where(is_around, weights, 0.0)
    weights = weights / weights.sum(dim=1, keepdim=True)
    turn = found.boxes[:, 6] - own[:, 6:]
    axis = torch.atan2(
        (weights * (2 * turn).sin()).sum(dim=1), (weights * (2 * turn).cos()).sum(dim=1)
    )
    is_front = (weights * (turn - axis[:, None] / 2).cos()).sum(dim=1) >= 0
    yaw = own[:, 6] + axis / 2 + torch.where(is_front, 0.0, torch.pi)
    return torch.cat((weights @ found.boxes[:, :6], wrap_angle(yaw)[:, None]), dim=1)

"""Training of the first stage: targets of cells, and losses."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Float32, Float64, Int64
from torch import Tensor

from sightline.detection3d.pillars.boxes import (
    AXIS,
    FRONT,
    QUALITY,
    PillarOutput,
    cell_middles,
    corner_costs,
    decode_centers,
    encode_centers,
    quality_from_iou,
)
from sightline.detection3d.pillars.config import (
    PillarGridConfig,
    PillarLossConfig,
    PillarNetworkConfig,
    PillarTargetsConfig,
)
from sightline.detection3d.sweeps import SweepTruth
from sightline.ops.rotated_iou import aligned_iou_3d

_FOCUS, _NEAR_FOCUS = 2, 4  # exponents of the heat loss, as published


class PillarTargets(NamedTuple):
    """Targets of a batch, in head cells."""

    heat: Float32[Tensor, "batch classes rows columns"]
    """1 in the cell of a centre, falling around it."""
    counts: Bool[Tensor, "batch classes rows columns"]
    """Mask of the cells with known heat."""
    cells: Int64[Tensor, "num_told 4"]
    """Sweep, class, row and column of the cells that predict a box."""
    boxes: Float32[Tensor, "num_told 7"]
    """Target boxes of these cells: x, y, z, length, width, height, yaw (LiDAR frame, metres,
    radians)."""
    weights: Float32[Tensor, " num_told"]
    """1 / number of the object's cells, so that all objects have the same weight."""


def pillar_targets(
    scenes: Sequence[SweepTruth],
    num_classes: int,
    grid: PillarGridConfig,
    config: PillarTargetsConfig,
) -> PillarTargets:
    """Make targets with Gaussians at centres, as in Yin et al. 2021 (CenterPoint), for one grid.

    Objects with a centre outside the grid are ignored as far as they reach into it. The cell of the
    centre always predicts the box. A cell with several objects of a class predicts the one with the
    nearest centre to its middle, the first at equal distance, so an object may lose all its cells.
    """
    size = grid.head_size
    heat = torch.zeros(len(scenes), num_classes, *size)
    counts = torch.ones(len(scenes), num_classes, *size, dtype=torch.bool)
    cells = [torch.zeros(0, 4, dtype=torch.int64)]
    boxes, weights = [heat.new_zeros(0, 7)], [heat.new_zeros(0)]
    for sweep, scene in enumerate(scenes):
        center = _center_cells(scene.boxes, grid)
        is_inside = ((center >= 0) & (center < center.new_tensor(size))).all(dim=1)
        for index in is_inside.nonzero()[:, 0].tolist():
            class_heat = heat[sweep, int(scene.classes[index])]
            _add_heat(class_heat, scene.boxes[index], grid, config)
        _leave_out(counts[sweep], scene, is_inside, grid, config)
        for class_index in range(num_classes):
            mine = scene.boxes[is_inside & (scene.classes == class_index)]
            row, column, owner = _box_cells(mine, grid, config)
            place = torch.full_like(row, sweep), torch.full_like(row, class_index), row, column
            cells.append(torch.stack(place, dim=1))
            boxes.append(mine[owner].float())
            weights.append(1 / torch.bincount(owner, minlength=len(mine))[owner].float())
    counts |= heat == 1  # a centre counts even inside an ignored area
    return PillarTargets(heat, counts, torch.cat(cells), torch.cat(boxes), torch.cat(weights))


class _CellWindow(NamedTuple):
    """Cells around a box."""

    rows: slice
    columns: slice
    offset_x: Float64[Tensor, "window_rows 1"]
    """Offset from the box's centre to the cells' middles [m]."""
    offset_y: Float64[Tensor, "1 window_columns"]


def _window(box: Float64[Tensor, "7"], reach_m: float, grid: PillarGridConfig) -> _CellWindow:
    spans, offsets = [], []
    for center, low, size in zip(
        box[:2].tolist(), (grid.x_m[0], grid.y_m[0]), grid.head_size, strict=True
    ):
        first = math.floor((center - reach_m - low) / grid.head_cell_m)
        last = math.floor((center + reach_m - low) / grid.head_cell_m)
        span = slice(min(max(first, 0), size), min(max(last + 1, 0), size))
        middles = torch.arange(span.start, span.stop, dtype=torch.float64) + 0.5
        spans.append(span)
        offsets.append(middles * grid.head_cell_m + low - center)
    return _CellWindow(spans[0], spans[1], offsets[0][:, None], offsets[1][None])


def _in_box_frame(
    window: _CellWindow, box: Float64[Tensor, "7"]
) -> tuple[Float64[Tensor, "rows columns"], Float64[Tensor, "rows columns"]]:
    """Compute the distances of the cells' middles along and across the box [m], unsigned."""
    cos, sin = box[6].cos(), box[6].sin()
    along = cos * window.offset_x + sin * window.offset_y
    across = cos * window.offset_y - sin * window.offset_x
    return along.abs(), across.abs()


def _center_cells(
    boxes: Float64[Tensor, "num_boxes 7"], grid: PillarGridConfig
) -> Int64[Tensor, "num_boxes 2"]:
    origin = boxes.new_tensor([grid.x_m[0], grid.y_m[0]])
    return ((boxes[:, :2] - origin) / grid.head_cell_m).floor().long()


def _add_heat(
    heat: Float32[Tensor, "rows columns"],
    box: Float64[Tensor, "7"],
    grid: PillarGridConfig,
    config: PillarTargetsConfig,
) -> None:
    """Add the heat of a box to its class's map."""
    deviation_m = config.heat_share * math.sqrt(float(box[3] * box[4]))
    window = _window(box, 4 * deviation_m, grid)  # beyond, the heat is below 1 / 2000
    squared = window.offset_x**2 + window.offset_y**2
    around = torch.exp(-squared / (2 * deviation_m**2)).float()
    part = heat[window.rows, window.columns]
    torch.maximum(part, around, out=part)
    row, column = _center_cells(box[None], grid)[0].tolist()
    heat[row, column] = 1


def _leave_out(
    counts: Bool[Tensor, "classes rows columns"],
    scene: SweepTruth,
    is_inside: Bool[Tensor, " num_objects"],
    grid: PillarGridConfig,
    config: PillarTargetsConfig,
) -> None:
    """Mask the cells in and around ignored objects."""
    outside = (~is_inside).nonzero()[:, 0]
    own_class = torch.arange(len(counts)) == scene.classes[outside, None]
    boxes = torch.cat((scene.ignored_boxes, scene.boxes[outside]))
    classes = torch.cat((scene.ignored_classes, own_class))
    for box, ignored_classes in zip(boxes, classes, strict=True):
        margin_m = config.ignored_margin_m
        window = _window(box, math.hypot(box[3], box[4]) / 2 + 2 * margin_m, grid)
        along, across = _in_box_frame(window, box)
        within = (along <= box[3] / 2 + margin_m) & (across <= box[4] / 2 + margin_m)
        counts[:, window.rows, window.columns] &= ~(ignored_classes[:, None, None] & within)


def _box_cells(
    boxes: Float64[Tensor, "num_boxes 7"], grid: PillarGridConfig, config: PillarTargetsConfig
) -> tuple[Int64[Tensor, " num_cells"], Int64[Tensor, " num_cells"], Int64[Tensor, " num_cells"]]:
    """Find row, column and box index of the cells that predict a box of one class."""
    nearest = torch.full(grid.head_size, math.inf, dtype=torch.float64)
    owner = torch.full(grid.head_size, -1)
    for index, box in enumerate(boxes):
        window = _window(box, math.hypot(box[3], box[4]) / 2 + grid.head_cell_m, grid)
        along, across = _in_box_frame(window, box)
        is_covered = along <= config.told_length_share * box[3] / 2
        is_covered &= across <= config.told_width_share * box[4] / 2
        row, column = _center_cells(box[None], grid)[0].tolist()
        is_covered[row - window.rows.start, column - window.columns.start] = True
        squared = window.offset_x**2 + window.offset_y**2
        part = nearest[window.rows, window.columns]
        is_covered &= squared < part
        part[is_covered] = squared[is_covered]
        owner[window.rows, window.columns][is_covered] = index
    row, column = (owner >= 0).nonzero(as_tuple=True)
    return row, column, owner[row, column]


class PillarLosses(NamedTuple):
    """Scalar losses; the parts are unweighted."""

    total: Float[Tensor, ""]
    heat: Float[Tensor, ""]
    box: Float[Tensor, ""]
    corners: Float[Tensor, ""]
    front: Float[Tensor, ""]
    quality: Float[Tensor, ""]


def pillar_loss(
    output: PillarOutput,
    targets: PillarTargets,
    network: PillarNetworkConfig,
    config: PillarLossConfig,
) -> PillarLosses:
    """Compute the loss of a batch, divided by the number of its objects.

    Without objects, all parts but the heat are 0, and so are their gradients. The quality target is
    the IoU of the current boxes; its loss has no gradient for the boxes.
    """
    heat = heat_loss(output.heat_logits, targets.heat, targets.counts)
    sweep, class_index, row, column = targets.cells.unbind(dim=1)
    values = output.center_values[sweep, class_index, :, row, column]
    middles = cell_middles(targets.cells[:, 2:], network.grid).to(values.dtype)
    mean_sizes = values.new_tensor([entry.mean_size_m for entry in network.classes])[class_index]
    truth = targets.boxes.to(values.dtype)
    target = encode_centers(truth, middles, mean_sizes)
    decoded = decode_centers(values, middles, mean_sizes)
    error = F.smooth_l1_loss(
        values[:, : AXIS.stop], target[:, : AXIS.stop], reduction="none", beta=config.knee
    )
    with torch.no_grad():
        quality = quality_from_iou(aligned_iou_3d(decoded, truth))
    costs = (
        error.sum(dim=1),
        corner_costs(decoded, truth, knee_m=2 * config.knee),
        (values[:, FRONT] - target[:, FRONT]).square().sum(dim=1),
        F.binary_cross_entropy_with_logits(values[:, QUALITY], quality, reduction="none"),
    )
    weights = targets.weights.to(values.dtype)
    number = weights.sum().clamp(min=1)
    box, corners, front, rated = ((cost * weights).sum() / number for cost in costs)
    total = config.heat_weight * heat + config.box_weight * box + config.corner_weight * corners
    total = total + config.front_weight * front + config.quality_weight * rated
    return PillarLosses(total, heat, box, corners, front, rated)


def heat_loss(
    logits: Float[Tensor, "*shape"], heat: Float[Tensor, "*shape"], counts: Bool[Tensor, "*shape"]
) -> Float[Tensor, ""]:
    """Focal loss of heat over the number of centres, or over 1: Law and Deng 2018, eq. 1.

    High heat costs less in cells near a centre. Cells with unknown heat do not count.
    """
    score = logits.sigmoid()
    is_center = heat == 1
    cold = (1 - heat) ** _NEAR_FOCUS * score**_FOCUS * F.logsigmoid(-logits)
    cost = -torch.where(is_center, (1 - score) ** _FOCUS * F.logsigmoid(logits), cold)
    number = (is_center & counts).sum().clamp(min=1)
    return torch.where(counts, cost, 0.0).sum() / number

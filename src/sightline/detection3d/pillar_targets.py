"""Targets of the compact first stage's cells."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float32, Float64, Int64
from torch import Tensor

from sightline.detection3d.pillar_config import PillarGridConfig
from sightline.detection3d.targets import SweepTruth


@dataclass(frozen=True, kw_only=True)
class PillarTargetsConfig:
    """Assignment of cells to objects; shares of the size treat cars and pedestrians alike."""

    heat_share: float = 0.28
    """Standard deviation of the heat around a centre, as a share of sqrt(length x width)."""
    told_length_share: float = 0.5
    """Share of the length about the centre in which cells predict the box."""
    told_width_share: float = 0.6
    """Share of the width about the centre in which cells predict the box."""
    ignored_margin_m: float = 0.3
    """Distance around ignored objects in which the heat does not count."""

    def __post_init__(self) -> None:
        """Checks the numbers."""
        for name in ("heat_share", "told_length_share", "told_width_share"):
            value = getattr(self, name)
            if not 0 < value <= 1:
                raise ValueError(f"{name} must be above 0 and at most 1, got {value}")
        if not 0 <= self.ignored_margin_m < math.inf:
            raise ValueError(
                f"ignored_margin_m must be finite and not negative, got {self.ignored_margin_m}"
            )


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
    config: PillarTargetsConfig = PillarTargetsConfig(),
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
        is_inside = _has_center(scene.boxes, grid)
        for index in is_inside.nonzero()[:, 0].tolist():
            class_heat = heat[sweep, int(scene.classes[index])]
            _add_heat(class_heat, scene.boxes[index], grid, config)
        _leave_out(counts[sweep], scene, is_inside, grid, config)
        for class_index in range(num_classes):
            mine = scene.boxes[is_inside & (scene.classes == class_index)]
            row, column, owner = _told_cells(mine, grid, config)
            place = torch.full_like(row, sweep), torch.full_like(row, class_index), row, column
            cells.append(torch.stack(place, dim=1))
            boxes.append(mine[owner].float())
            weights.append(1 / torch.bincount(owner, minlength=len(mine))[owner].float())
    counts |= heat == 1  # a centre counts even inside an ignored area
    return PillarTargets(heat, counts, torch.cat(cells), torch.cat(boxes), torch.cat(weights))


class _Window(NamedTuple):
    """Cells around a box."""

    rows: slice
    columns: slice
    offset_x: Float64[Tensor, "window_rows 1"]
    """Offset from the box's centre to the cells' middles [m]."""
    offset_y: Float64[Tensor, "1 window_columns"]


def _window(box: Float64[Tensor, "7"], reach_m: float, grid: PillarGridConfig) -> _Window:
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
    return _Window(spans[0], spans[1], offsets[0][:, None], offsets[1][None])


def _in_box_frame(
    window: _Window, box: Float64[Tensor, "7"]
) -> tuple[Float64[Tensor, "rows columns"], Float64[Tensor, "rows columns"]]:
    """Compute the distances of the cells' middles along and across the box [m], unsigned."""
    cos, sin = box[6].cos(), box[6].sin()
    along = cos * window.offset_x + sin * window.offset_y
    across = cos * window.offset_y - sin * window.offset_x
    return along.abs(), across.abs()


def _has_center(
    boxes: Float64[Tensor, "num_boxes 7"], grid: PillarGridConfig
) -> Bool[Tensor, " num_boxes"]:
    cell = _center_cells(boxes, grid)
    return ((cell >= 0) & (cell < cell.new_tensor(grid.head_size))).all(dim=1)


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
    for box, of_classes in zip(boxes, classes, strict=True):
        margin_m = config.ignored_margin_m
        window = _window(box, math.hypot(box[3], box[4]) / 2 + 2 * margin_m, grid)
        along, across = _in_box_frame(window, box)
        within = (along <= box[3] / 2 + margin_m) & (across <= box[4] / 2 + margin_m)
        counts[:, window.rows, window.columns] &= ~(of_classes[:, None, None] & within)


def _told_cells(
    boxes: Float64[Tensor, "num_boxes 7"], grid: PillarGridConfig, config: PillarTargetsConfig
) -> tuple[Int64[Tensor, " told"], Int64[Tensor, " told"], Int64[Tensor, " told"]]:
    """Find row, column and box index of the cells that predict a box of one class."""
    nearest = torch.full(grid.head_size, math.inf, dtype=torch.float64)
    owner = torch.full(grid.head_size, -1)
    for index, box in enumerate(boxes):
        window = _window(box, math.hypot(box[3], box[4]) / 2 + grid.head_cell_m, grid)
        along, across = _in_box_frame(window, box)
        tells = along <= config.told_length_share * box[3] / 2
        tells &= across <= config.told_width_share * box[4] / 2
        row, column = _center_cells(box[None], grid)[0].tolist()
        tells[row - window.rows.start, column - window.columns.start] = True
        squared = window.offset_x**2 + window.offset_y**2
        part = nearest[window.rows, window.columns]
        tells &= squared < part
        part[tells] = squared[tells]
        owner[window.rows, window.columns][tells] = index
    row, column = (owner >= 0).nonzero(as_tuple=True)
    return row, column, owner[row, column]

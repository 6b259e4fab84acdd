"""The glazed cabin of cars and vans on top of their lower body.

It is a grid of rings like the lower body, with lines at the edges of windows and pillars. "Way" is
the position along one side: 0 to 1 from the windscreen's middle to its corner, one unit for each of
the three side windows, 4 to 5 from the rear corner to the rear window's middle.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int

from sightline.simulation.meshes.body import (
    BLACK_PLASTIC,
    CROWN,
    TAIL_LIGHT,
    TINTED_GLASS,
    Body,
    BodyForm,
    within,
)
from sightline.simulation.meshes.edits import painted
from sightline.simulation.meshes.primitives import grid, without_slivers
from sightline.simulation.scene import Mesh

_ROOF_ROWS = np.array([0.965, 0.86, 0.6, 0.3, 0.0])  # from the roof's edge to its middle
_WAYS_BETWEEN = (0.0, 0.3, 0.6, 0.94, 1.03, 1.5, 2.5, 3.05, 3.85, 3.96, 4.07, 4.4, 4.7, 5.0)
_FRONT_PILLAR = (1.925, 2.06)  # ways of the black pillar between the doors
_LAMP = (3.96, 4.12)  # ways of a tail light beside the rear window
_SILL_LEVEL, _FRAME_LEVEL = 0.115, 0.075
_HEADER = 0.045  # height of the black frame above the windows, as a share of the cabin's height


class _Window(NamedTuple):
    start: float
    """Way of the start."""
    end: float
    frame: float
    """Width of the black frame on either side, in units of way."""
    is_glazed: bool


def cabin(body: Body) -> Mesh:
    """Build windows, pillars and roof."""
    ways, sides = _columns(body.form)
    walls = _wall_points(body, ways, sides)
    points = np.concatenate((walls, _roof_points(body, walls[-1])))
    skin = grid(points, body.roof, closed=True)
    rows = np.concatenate((_levels(body.form), 2 - _ROOF_ROWS))
    level = (rows[1:] + rows[:-1])[:, None] / 2
    cells = _cells(body.form, level, (ways + np.roll(ways, -1)) / 2)
    palette = (body.roof, TINTED_GLASS, BLACK_PLASTIC, TAIL_LIGHT)
    return without_slivers(painted(skin, cells, palette))


def _windows(form: BodyForm) -> tuple[_Window, ...]:
    last_end = 2.95 + form.last_window_end
    return (
        _Window(-1.0, 0.84, 0.035, is_glazed=True),
        _Window(1.11, _FRONT_PILLAR[0], 0.03, form.glazed[0]),
        _Window(_FRONT_PILLAR[1], 2.93, 0.03, form.glazed[1]),
        _Window(3.10, last_end, 0.05, form.glazed[2]),
        _Window(4.17, 6.0, 0.035, form.rear_glazed),
    )


def _levels(form: BodyForm) -> Float64[np.ndarray, " rows"]:
    """Compute the heights of the walls' rows, from the cabin's base 0 to its roof 1."""
    top = form.window_top
    return np.array([0.0, _FRAME_LEVEL, _SILL_LEVEL, 0.45, top, top + _HEADER, 1.0])


def _columns(
    form: BodyForm,
) -> tuple[Float64[np.ndarray, " columns"], Float64[np.ndarray, " columns"]]:
    """Compute columns' way and side (1 left, -1 right), from the front's middle over the left."""
    edges = [
        edge
        for window in _windows(form)
        for edge in (
            window.start - window.frame,
            window.start,
            window.end,
            window.end + window.frame,
        )
        if 0 < edge < 5
    ]
    left = np.unique(np.array([*edges, *_WAYS_BETWEEN]))
    right = left[-2:0:-1]
    sides = np.repeat((1.0, -1.0), (len(left), len(right)))
    return np.concatenate((left, right)), sides


def _wall_points(
    body: Body, way: Float64[np.ndarray, " columns"], side: Float64[np.ndarray, " columns"]
) -> Float64[np.ndarray, "rows columns 3"]:
    """Compute the rings from the sill to the edge of the roof."""
    form, half = body.form, body.length / 2
    level = _levels(form)[:, None]
    bulge = 0.02 * np.sin(np.pi * level)
    corner = body.screen_x(level) + bulge
    end = (form.rear_base + level * (form.rear_top - form.rear_base)) * half - bulge
    first, second = form.pillars[0] * half, form.pillars[1] * half
    knots = np.broadcast_arrays(corner, first, np.maximum(second, end + 0.02), end)
    x = _along_side(np.concatenate(knots, axis=1), way)
    to_middle = np.where(way < 1, way, np.where(way > 4, 5 - way, 1.0))
    x += np.where(way < 1, form.screen_bow_m * (1 - 0.35 * level) * (1 - to_middle**2), 0)
    x -= np.where(way > 4, form.rear_bow_m * (1 - to_middle**3), 0)
    ahead = np.clip((x - first) / (corner - first), 0, 1.2)
    behind = np.clip((first - x) / (first - end), 0, 1.2)
    narrowing = 1 - 0.05 * ahead**2 - 0.07 * behind**2.5
    y = body.cabin_half_width(level) * to_middle * narrowing * side
    sill = body.shoulder_height(x[0]) + CROWN * (1 - np.square(y[0] / (body.width / 2))) - 0.03
    z = sill + level * (_roof_height(body, x[-1], y[-1], y[-1]) - sill)
    return np.stack((x, y, z), axis=-1)


def _along_side(
    knots: Float64[np.ndarray, "rows 4"], way: Float64[np.ndarray, " columns"]
) -> Float64[np.ndarray, "rows columns"]:
    """Compute x of each column: `knots` are the places at ways 1, 2, 3 and 4."""
    along = np.clip(way - 1, 0, 3)
    index = np.minimum(along.astype(np.int64), 2)
    x: Float64[np.ndarray, "rows columns"] = knots[:, index] + (along - index) * (
        knots[:, index + 1] - knots[:, index]
    )
    return x


def _roof_points(
    body: Body, edge: Float64[np.ndarray, "columns 3"]
) -> Float64[np.ndarray, "rows columns 3"]:
    """Compute the rings from the edge of the roof to its middle line."""
    y = np.outer(_ROOF_ROWS, edge[:, 1])
    x = np.broadcast_to(edge[:, 0], y.shape)
    return np.stack((x, y, _roof_height(body, x, y, edge[:, 1])), axis=-1)


def _roof_height(
    body: Body,
    x: Float64[np.ndarray, "*rows columns"],
    y: Float64[np.ndarray, "*rows columns"],
    edge_y: Float64[np.ndarray, " columns"],
) -> Float64[np.ndarray, "*rows columns"]:
    """Compute the height [m] of the roof, which falls to both ends and to the sides."""
    form, half = body.form, body.length / 2
    middle = (form.screen_top + form.rear_top) / 2 * half
    reach = (form.screen_top - form.rear_top) / 2 * half
    fall = np.where(x > middle, form.roof_fall_front_m, form.roof_fall_rear_m)
    across = np.abs(y) / np.abs(edge_y).max()
    height: Float64[np.ndarray, "*rows columns"] = (
        body.height - form.roof_crown_m * across**2.5 - fall * np.square((x - middle) / reach)
    )
    return height


def _cells(
    form: BodyForm, level: Float64[np.ndarray, "cell_rows 1"], way: Float64[np.ndarray, " columns"]
) -> Int[np.ndarray, "cell_rows columns"]:
    """Choose the finish of each cell: paint, glass or plastic."""
    cells = np.zeros((len(level), len(way)), dtype=np.int64)
    glass_rows = within(level, _SILL_LEVEL, form.window_top)
    frame_rows = within(level, _FRAME_LEVEL, form.window_top + _HEADER)
    for window in _windows(form):
        if window.is_glazed:
            framed = within(way, window.start - window.frame, window.end + window.frame)
            cells[frame_rows & framed] = 2
            cells[glass_rows & within(way, window.start, window.end)] = 1
    if form.glazed[0]:
        cells[frame_rows & within(way, *_FRONT_PILLAR)] = 2
    if form.pillar_lamps:
        cells[within(level, _SILL_LEVEL, form.window_top) & within(way, *_LAMP)] = 3
    below_screen = (level < _SILL_LEVEL) & (way < 0.875)
    cells[below_screen] = 2
    return cells

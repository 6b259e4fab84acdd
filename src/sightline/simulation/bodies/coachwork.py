"""Boxes with round corners and panels set into them: cabs of lorries, cargo boxes, trams."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from sightline.simulation.scene import Mesh
from sightline.simulation.shapes.edits import painted
from sightline.simulation.shapes.primitives import Finish, grid, without_slivers

_CORNER_STEPS = 3
_ROOF_ROWS = np.array([0.96, 0.80, 0.0])


Face = Enum("Face", "FRONT SIDES REAR", start=0)  # outer face of a box that a panel lies in


class Panel(NamedTuple):
    """Rectangle of another finish."""

    face: Face
    start: float  # start along x at the sides, or along |y| at the ends [m]
    end: float
    low: float  # lower height [m]
    high: float
    finish: Finish


@dataclass(frozen=True, kw_only=True, slots=True)
class Coachwork:
    """Box from x = -length / 2 to length / 2 with walls that may lean."""

    length: float
    width: float
    low: float  # height [m] of the floor
    high: float  # height [m] of the roof
    corner: float  # radius [m] of the upright edges
    crown: float = 0.04  # additional height [m] of the roof in the middle
    profile: tuple[tuple[float, float, float], ...] = ()
    """(height, inset of the front, inset of the sides) [m] at the bends of the walls, upwards."""
    rear_leans: bool = False  # whether the rear has the same insets as the front


def coachwork_mesh(work: Coachwork, finish: Finish, panels: Sequence[Panel] = ()) -> Mesh:
    """Build the closed box; later panels lie over earlier ones."""
    columns = _columns(work, panels)
    edges = [height for panel in panels for height in (panel.low, panel.high)]
    bends = [height for height, _, _ in work.profile]
    heights = _apart(np.array([*edges, *bends], np.float64), work.low, work.high)
    skin = grid(_points(work, columns, heights), finish, closed=True)
    low, high = np.full(2, work.low - 1), np.full(len(_ROOF_ROWS), work.high + 1)
    rows = np.concatenate((low[:1], heights, high))
    middle_z = (rows[1:] + rows[:-1])[:, None] / 2
    middle = (columns + np.roll(columns, -1, axis=0)) / 2
    middle_x, middle_y = middle[:, 0], np.abs(middle[:, 1])
    half, half_width = work.length / 2 - 0.3 * work.corner, work.width / 2 - 0.3 * work.corner
    on_face = {
        Face.FRONT: middle_x > half,
        Face.REAR: middle_x < -half,
        Face.SIDES: middle_y > half_width,
    }
    cells = np.zeros((len(middle_z), len(columns)), dtype=np.int64)
    for index, panel in enumerate(panels, start=1):
        along = middle_x if panel.face is Face.SIDES else middle_y
        here = on_face[panel.face] & (along > panel.start) & (along < panel.end)
        cells[here & (middle_z > panel.low) & (middle_z < panel.high)] = index
    palette = (finish, *(panel.finish for panel in panels))
    return without_slivers(painted(skin, cells, palette))


def _columns(work: Coachwork, panels: Sequence[Panel]) -> Float64[np.ndarray, "columns 2"]:
    """Compute (x, y) of the columns, counter-clockwise from the front's middle over the left."""
    half, half_width, corner = work.length / 2, work.width / 2, work.corner
    ends, sides = half_width - corner, half - corner
    front = _breaks(panels, Face.FRONT, 0.0, ends)
    rear = _breaks(panels, Face.REAR, 0.0, ends)[::-1]
    side = _breaks(panels, Face.SIDES, -sides, sides)[::-1]
    angles = np.linspace(0, np.pi / 2, _CORNER_STEPS + 1)[1:-1]
    bend = np.stack((np.cos(angles), np.sin(angles)), axis=1) * corner + (sides, ends)
    left = np.concatenate(
        (
            np.stack((np.full_like(front, half), front), axis=1),
            bend,
            np.stack((side, np.full_like(side, half_width)), axis=1),
            bend[::-1] * (-1, 1),
            np.stack((np.full_like(rear, -half), rear), axis=1),
        )
    )
    return np.concatenate((left, left[-2:0:-1] * (1, -1)))


def _breaks(
    panels: Sequence[Panel], face: Face, low: float, high: float
) -> Float64[np.ndarray, " breaks"]:
    edges = [edge for panel in panels if panel.face is face for edge in (panel.start, panel.end)]
    return _apart(np.array(edges, np.float64), low, high)


def _apart(
    values: Float64[np.ndarray, " values"], low: float, high: float
) -> Float64[np.ndarray, " kept"]:
    """Sort `low`, the values between, and `high`; of values closer than 2 mm, one is kept."""
    inner = np.sort(values[(values > low + 2e-3) & (values < high - 2e-3)])
    inner = inner[np.diff(inner, prepend=low) > 2e-3]
    return np.concatenate(([low], inner, [high]))


def _points(
    work: Coachwork,
    columns: Float64[np.ndarray, "columns 2"],
    heights: Float64[np.ndarray, " rows"],
) -> Float64[np.ndarray, "all_rows columns 3"]:
    """Compute the rings from the middle of the floor, up the walls and in over the roof."""
    profile = np.array(work.profile or ((work.low, 0.0, 0.0),))
    front = np.interp(heights, profile[:, 0], profile[:, 1])[:, None]
    side = np.interp(heights, profile[:, 0], profile[:, 2])[:, None]
    x, y = columns.T
    edge = work.length / 2 - work.corner
    ahead = np.clip((x - edge) / work.corner, 0, 1)
    if work.rear_leans:
        ahead = ahead - np.clip((-x - edge) / work.corner, 0, 1)
    wall_x, wall_y = x - front * ahead, y * (1 - side / (work.width / 2))
    shape = (len(heights), len(x))
    walls = np.stack((wall_x, wall_y, np.broadcast_to(heights[:, None], shape)), axis=-1)
    floor = walls[:1] * (1, 0, 1)
    rows = _ROOF_ROWS[:, None]
    rise = work.crown * (1 - rows**2)
    roof = np.stack(
        (
            wall_x[-1] - 0.5 * ahead * work.corner * (1 - rows) ** 0.5,
            rows * wall_y[-1],
            work.high + rise + 0 * x,
        ),
        axis=-1,
    )
    return np.concatenate((floor, walls, roof))

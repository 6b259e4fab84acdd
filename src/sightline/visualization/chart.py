"""Axes and title of a chart of shares."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import UInt8

from sightline.visualization.canvas import put_lines
from sightline.visualization.cells import MUTED
from sightline.visualization.colors import RGB
from sightline.visualization.lettering import put_text, text_width

BACKGROUND: RGB = (22, 25, 30)
GRID: RGB = (64, 70, 80)
TEXT: RGB = (222, 225, 230)
AXIS_TEXT_PX = 9

SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Positions of grid lines."""
SHARE_COLUMNS = tuple((share, f"{share:g}") for share in SHARES)
"""Positions and labels of the vertical grid lines."""
PERCENT_ROWS = tuple((share, f"{100 * share:.0f} %") for share in SHARES)
"""Positions and labels of the horizontal grid lines, in percent."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Plot:
    """Position of a chart's axes, both from 0 to 1, in its picture [px]."""

    left: int
    right: int
    top: int
    bottom: int
    text_px: int = AXIS_TEXT_PX
    """Height of the title's capitals; the axes' labels are a little smaller."""

    def column(self, share: float) -> float:
        """Column of a share along the horizontal axis [px]."""
        return self.left + share * (self.right - self.left)

    def row(self, share: float) -> float:
        """Row of a share along the vertical axis [px]."""
        return self.bottom - share * (self.bottom - self.top)


def put_axes(
    canvas: UInt8[np.ndarray, "height width 3"],
    plot: Plot,
    *,
    columns: Sequence[tuple[float, str]] = SHARE_COLUMNS,
    rows: Sequence[tuple[float, str]] = PERCENT_ROWS,
) -> None:
    """Draw the grid, with labels beside its rows and below its columns."""
    height = plot.text_px - 1
    for share, text in rows:
        row = plot.row(share)
        segment = np.array([[[plot.left, row], [plot.right, row]]], dtype=np.float64)
        put_lines(canvas, segment, GRID)
        left = plot.left - text_width(text, height) - 5
        put_text(canvas, text, left, round(row) + height // 2, height_px=height, color=MUTED)
    for share, text in columns:
        column = plot.column(share)
        segment = np.array([[[column, plot.top], [column, plot.bottom]]], dtype=np.float64)
        put_lines(canvas, segment, GRID)
        left = round(column) - text_width(text, height) // 2
        put_text(canvas, text, left, plot.bottom + height + 6, height_px=height, color=MUTED)


def put_title(canvas: UInt8[np.ndarray, "height width 3"], plot: Plot, title: str) -> None:
    """Write a title above the plot's left edge."""
    put_text(canvas, title, plot.left, plot.top - 9, height_px=plot.text_px + 1, color=TEXT)

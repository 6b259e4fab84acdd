"""Cells of a gate's map beside a mask, pixel by pixel."""

import math


def cell_pixels(cell, num_cells, num_pixels):
    """Rows (or columns) of the image that a row (or column) of the map lies over."""
    start = math.floor(cell * num_pixels / num_cells)
    return range(start, math.ceil((cell + 1) * num_pixels / num_cells))


def split(gate, mask, has_point):
    """Gates of the cells that are mostly masked, and of those that are not masked at all.

    Cells without any point are left out.
    """
    rows, columns = len(gate), len(gate[0])
    masked, clear = [], []
    for row in range(rows):
        for column in range(columns):
            pixels = [
                (y, x)
                for y in cell_pixels(row, rows, len(mask))
                for x in cell_pixels(column, columns, len(mask[0]))
            ]
            if not any(has_point[y][x] for y, x in pixels):
                continue
            marked = sum(mask[y][x] for y, x in pixels)
            if 2 * marked > len(pixels):
                masked.append(gate[row][column])
            elif marked == 0:
                clear.append(gate[row][column])
    return masked, clear


def gate_laid_over_frame(gates, tops, sizes, shrinkings, full_height, cell_px=8):
    """Gate of each cell of a frame: that of the first view under its middle, else 0.

    A view is shrunk by a factor, begins at a row and has a size [px]; enlarged ones have 0.
    """
    columns = max(round(sizes[0][1] / cell_px), 1)
    laid = [[0.0] * columns for _ in range(max(round(full_height / cell_px), 1))]
    for y, row in enumerate(laid):
        for x in range(columns):
            for gate, top, size, shrunk in zip(gates, tops, sizes, shrinkings, strict=True):
                if shrunk < 1:
                    continue
                seen_rows, seen_columns = (max(round(side / cell_px), 1) for side in size)
                seen_y = math.floor((y + 0.5) / shrunk - top / cell_px)
                seen_x = min(math.floor((x + 0.5) / shrunk), seen_columns - 1)
                if 0 <= seen_y < seen_rows:
                    row[x] = gate[seen_y][seen_x]
                    break
    return laid

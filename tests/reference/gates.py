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

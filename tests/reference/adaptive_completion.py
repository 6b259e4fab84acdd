"""The steps of adaptive completion, one pixel at a time over lists of lists; 0 = none."""

import math
from fractions import Fraction


def right_neighbour(image, y, x, reach_columns, reach_rows):
    """(columns, rows) to the next measured pixel on the right; (0, 0) where there is none."""
    candidates = []
    for v in range(len(image)):
        for u in range(x + 1, min(x + reach_columns, len(image[0]) - 1) + 1):
            # 0.4 rows per column, one more to start with
            span = min(1 + math.floor(Fraction(2, 5) * (u - x)), reach_rows)
            if image[v][u] > 0 and abs(v - y) <= span:
                candidates.append((u - x, abs(v - y), v - y))
    if not candidates:
        return (0, 0)
    gap, _, offset = min(candidates)
    return (gap, offset)


def is_hidden(image, y, x, reach_rows, reach_columns, ratio):
    """Whether surfaces `ratio` times nearer lie both above and below (its row is both)."""

    def in_front(rows):
        return any(
            image[v][u] > ratio * image[y][x]
            for v in rows
            for u in range(len(image[0]))
            if 0 <= v < len(image) and abs(u - x) <= reach_columns
        )

    return in_front(range(y - reach_rows, y + 1)) and in_front(range(y, y + reach_rows + 1))


def fill_column(column):
    """Inverse depths of one column, and rows to the nearest given one; None if there is none."""
    given = [y for y, value in enumerate(column) if value > 0]
    if not given:
        return None
    filled, distance = [], []
    for y, value in enumerate(column):
        above = [v for v in given if v <= y]
        below = [v for v in given if v >= y]
        distance.append(min(abs(v - y) for v in given))
        if value > 0:
            filled.append(value)
        elif not above:
            filled.append(column[below[0]])
        elif not below:
            filled.append(column[given[-1]] + growth_below(column, given, y))
        else:
            a, b = above[-1], below[0]
            filled.append(((b - y) * column[a] + (y - a) * column[b]) / (b - a))
    return filled, distance


def growth_below(column, given, y):
    """The slope of the last gap goes on, for twice its rows at most, if it is a rise.

    Neighbouring rows belong to one ring, whose lowest row counts with the last row of the ring
    above.
    """
    lowest = given[-1]
    start = lowest
    while start - 1 in given:
        start -= 1
    before = [v for v in given if v < start]
    if not before:
        return 0
    gap = lowest - before[-1]
    slope = (column[lowest] - column[before[-1]]) / gap
    return max(slope, 0) * min(y - lowest, 2 * gap)


def bridge_row(values, distances, trusted, rows_above, least_distance):
    """`rows_above`: the distances of the rows above, from the top."""
    bridged = []
    for x, value in enumerate(values):
        left = [u for u in range(x) if trusted[u]]
        right = [u for u in range(x + 1, len(values)) if trusted[u]]
        if trusted[x] or not left or not right:
            bridged.append(value)
            continue
        a, b = left[-1], right[0]
        if distances[a + 1] < least_distance or distances[b - 1] < least_distance:
            bridged.append(value)  # beside a ring that bends
            continue
        above = [
            u
            for u in range(a + 1, b)
            if distances[u] not in (0, math.inf) and all(row[u] != 0 for row in rows_above)
        ]
        if b - a - 1 > 2 * sum(trusted) and len(above) > (b - a - 1) / 2:
            bridged.append(value)  # no ring reaches it
            continue
        bridged.append(((b - x) * values[a] + (x - a) * values[b]) / (b - a))
    return bridged


def smooth_row(values, distances, share):
    smooth = []
    for x, distance in enumerate(distances):
        reach = int(share * distance)
        window = values[max(x - reach, 0) : x + reach + 1]
        smooth.append(sum(window) / len(window))
    return smooth

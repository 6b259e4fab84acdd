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


def is_hidden(image, y, x, ratio, rows_above, rows_below, columns, nearest_around):
    """Whether returns `ratio` times nearer lie both above and below (its row is both), in reach.

    A reach (base, growth) is base + growth * difference; none goes beyond what the difference to
    the nearest value around allows.
    """
    own = image[y][x]
    most = nearest_around - own

    def is_near(value, v, u, rows):
        difference = value - own
        return (
            value > ratio * own
            and abs(v - y) <= rows[0] + rows[1] * min(difference, most)
            and abs(u - x) <= columns[0] + columns[1] * min(difference, most)
        )

    if nearest_around <= ratio * own:
        return False
    returns = [(value, v, u) for v, row in enumerate(image) for u, value in enumerate(row)]
    above = any(v <= y and is_near(value, v, u, rows_above) for value, v, u in returns)
    below = any(v >= y and is_near(value, v, u, rows_below) for value, v, u in returns)
    return above and below


def fill_column(column, surface_ratio, ground_slope, nearer_share):
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
            top, bottom = column[a], column[b]
            is_ground = top < bottom <= top + ground_slope * (b - a)
            is_surface = max(top, bottom) <= surface_ratio * min(top, bottom)
            if nearer_share < 0 or is_ground or is_surface:
                filled.append(((b - y) * top + (y - a) * bottom) / (b - a))
            else:
                from_nearer = y - a if top > bottom else b - y
                is_nearer = from_nearer <= nearer_share * (b - a)
                filled.append(max(top, bottom) if is_nearer else min(top, bottom))
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


def near_or_above(image, reach):
    """Whether a pixel has a measurement in the square around it, or none above or beside it.

    Beside and above count within the columns of that square.
    """
    measured = [(y, x) for y, row in enumerate(image) for x, value in enumerate(row) if value > 0]

    def is_chosen(y, x):
        columns = [v for v, u in measured if abs(u - x) <= reach]
        return any(abs(v - y) <= reach for v in columns) or (bool(columns) and y < min(columns))

    return [[is_chosen(y, x) for x in range(len(image[0]))] for y in range(len(image))]

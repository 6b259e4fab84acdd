"""Compiled steps of adaptive completion, without torch. `adaptive` describes their purpose.

All work on inverse depths [1/m] in image layout, 0 = none.
"""

import numpy as np
from jaxtyping import Bool, Float32, Int64
from numpy import ndarray

from sightline.ops.compiled import compiled

NO_NEIGHBOUR = 0
"""Gap value for a pixel without a neighbour."""

RING_SLOPE = 0.4  # largest slope of a ring between two returns, in rows per column
MAX_HOLE_RATIO = 2  # largest width of a hole, per trusted pixel of its row
GROWTH_BELOW = 2  # rows of ground below the lowest ring, as a multiple of the last gap


@compiled
def inverse(values: Float32[ndarray, "height width"]) -> Float32[ndarray, "height width"]:
    """Convert depth to inverse depth or back: 1 / value, 0 where there is no value."""
    inverses = np.empty_like(values)
    for row in range(values.shape[0]):
        for column in range(values.shape[1]):
            value = values[row, column]
            inverses[row, column] = np.float32(1) / value if value > 0 else np.float32(0)
    return inverses


@compiled
def right_neighbours(
    inverse_depth: Float32[ndarray, "height width"],
    pixels: Int64[ndarray, "n 2"],
    reach_columns: int,
    reach_rows: int,
) -> Int64[ndarray, "n 2"]:
    """Find the columns and rows from each measured pixel to its right neighbour in the ring.

    The neighbour has the smallest column distance, then the smallest row distance; the upper one
    wins a tie. (`NO_NEIGHBOUR`, 0) if there is none within reach. The searched rows grow with the
    column distance.
    """
    height, width = inverse_depth.shape
    steps = np.zeros((len(pixels), 2), dtype=np.int64)
    for i in range(len(pixels)):
        row, column = pixels[i]
        for gap in range(1, min(reach_columns, width - 1 - column) + 1):
            span = min(1 + int(RING_SLOPE * gap), reach_rows)
            best = span + 1
            for offset in range(-span, span + 1):
                if not 0 <= row + offset < height:
                    continue
                if inverse_depth[row + offset, column + gap] > 0 and abs(offset) < abs(best):
                    best = offset
            if best <= span:
                steps[i, 0] = gap
                steps[i, 1] = best
                break
    return steps


@compiled
def gap_counts(
    is_covered: Bool[ndarray, "height width"],
) -> Int64[ndarray, " height_plus_1"]:
    """Histogram of the row distances between the tops of covered runs, over all columns."""
    height, width = is_covered.shape
    counts = np.zeros(height + 1, dtype=np.int64)
    top = np.full(width, -1, dtype=np.int64)
    for row in range(height):
        for column in range(width):
            if is_covered[row, column] and not (row > 0 and is_covered[row - 1, column]):
                if top[column] >= 0:
                    counts[row - top[column]] += 1
                top[column] = row
    return counts


@compiled
def hidden_pixels(
    inverse_depth: Float32[ndarray, "height width"],
    nearest_around: Float32[ndarray, "height width"],
    pixels: Int64[ndarray, "n 2"],
    ratio: float,
    rows_above: tuple[float, float],
    rows_below: tuple[float, float],
    columns: tuple[float, float],
) -> Bool[ndarray, " n"]:
    """Mask of the measured pixels that nearer ones above and below hide from the camera.

    A reach (base, growth) is base + growth * d pixels, where d is the difference of the two
    inverse depths: the parallax that moves a surface in front of another grows with d.

    Args:
        inverse_depth: The measured map.
        nearest_around: Largest inverse depth in the window around each pixel. Its difference to the
            pixel's inverse depth bounds the search.
        pixels: Rows and columns of the measured pixels.
        ratio: Smallest depth ratio to a pixel in front.
        rows_above: Reach upwards; the pixel's own row counts as above and below.
        rows_below: Reach downwards.
        columns: Reach to either side.
    """
    height, width = inverse_depth.shape
    hidden = np.zeros(len(pixels), dtype=np.bool_)
    for i in range(len(pixels)):
        row, column = pixels[i]
        own = inverse_depth[row, column]
        limit = np.float32(ratio * own)
        if nearest_around[row, column] <= limit:
            continue
        max_difference = nearest_around[row, column] - own
        top = max(row - int(rows_above[0] + rows_above[1] * max_difference), 0)
        bottom = min(row + int(rows_below[0] + rows_below[1] * max_difference), height - 1)
        beside = int(columns[0] + columns[1] * max_difference)
        left, right = max(column - beside, 0), min(column + beside, width - 1)
        above, below = False, False
        for other in range(top, bottom + 1):
            for at in range(left, right + 1):
                value = inverse_depth[other, at]
                if value <= limit:
                    continue
                nearer = value - own
                if abs(at - column) > columns[0] + columns[1] * nearer:
                    continue
                if other <= row and row - other <= rows_above[0] + rows_above[1] * nearer:
                    above = True
                if other >= row and other - row <= rows_below[0] + rows_below[1] * nearer:
                    below = True
            if (other >= row and not above) or (above and below):
                break
        hidden[i] = above and below
    return hidden


@compiled
def trace_rings(
    inverse_depth: Float32[ndarray, "height width"],
    pixels: Int64[ndarray, "n 2"],
    steps: Int64[ndarray, "n 2"],
    surface_ratio: float,
) -> Float32[ndarray, "height width"]:
    """Draw each measured pixel and the line to its right neighbour.

    On one surface the line is linear in inverse depth; between two surfaces each end keeps its
    half. Measured pixels keep their values. Where lines cross, the nearer depth wins.
    """
    traced = inverse_depth.copy()
    for i in range(len(pixels)):
        row, column = pixels[i]
        gap, offset = steps[i]
        if gap == NO_NEIGHBOUR:
            continue
        left = inverse_depth[row, column]
        right = inverse_depth[row + offset, column + gap]
        is_one_surface = max(left, right) <= surface_ratio * min(left, right)
        for step in range(1, gap):
            share = np.float32(step) / np.float32(gap)
            at_row = row + int(np.floor(offset * share + 0.5))
            at_column = column + step
            if is_one_surface:
                value = left + (right - left) * share
            else:
                value = left if share < 0.5 else right
            if inverse_depth[at_row, at_column] == 0 and value > traced[at_row, at_column]:
                traced[at_row, at_column] = value
    return traced


@compiled
def fill_columns(
    traced: Float32[ndarray, "height width"],
    trusted_gap: float,
    trusted_reach: float,
    surface_ratio: float,
    ground_slope: float,
    nearer_share: float,
) -> tuple[
    Float32[ndarray, "height width"],
    Float32[ndarray, "height width"],
    Bool[ndarray, "height width"],
]:
    """Fill each column from its traced pixels; columns without any stay empty.

    The fill is linear between two pixels of one surface. Between two surfaces the nearer one fills
    a share of the gap, the farther one the rest. The topmost value continues upwards. Below the
    lowest pixel the slope of the last gap continues for twice its rows if depth decreases
    downwards, as on the ground.

    Args:
        traced: The rings.
        trusted_gap: Largest trusted gap between two rings, in rows.
        trusted_reach: Rows from a ring that are always trusted. Below the lowest ring, the rows of
            the last gap if they are more, up to `trusted_gap`.
        surface_ratio: Largest ratio of two neighbouring depths on one surface.
        ground_slope: Largest growth of inverse depth [1/m] per row downwards on one surface, for
            any depth ratio: the slope of the road.
        nearer_share: Share of a gap between two surfaces that takes the nearer depth; negative:
            every gap is linear.

    Returns:
        Inverse depth; rows to the nearest traced pixel of the column; mask of trusted pixels.
    """
    height, width = traced.shape
    filled = np.zeros((height, width), dtype=np.float32)
    distance = np.zeros((height, width), dtype=np.float32)
    trusted = np.zeros((height, width), dtype=np.bool_)
    last = np.full(width, -1, dtype=np.int64)
    ring_before = np.full(width, -1, dtype=np.int64)
    for row in range(height):
        for column in range(width):
            value = traced[row, column]
            if value == 0:
                continue
            above = last[column]
            start = traced[max(above, 0), column] if above >= 0 else value
            gap = max(row - above, 1)
            step = (value - start) / np.float32(gap)
            near, far = max(value, start), min(value, start)
            is_linear = nearer_share < 0 or near <= surface_ratio * far
            is_linear |= 0 < value - start <= ground_slope * gap
            for at in range(above + 1, row):
                to_ring = row - at if above < 0 else min(at - above, row - at)
                if is_linear:
                    filled[at, column] = start + step * np.float32(at - above)
                else:
                    from_near = at - above if start > value else row - at
                    filled[at, column] = near if from_near <= nearer_share * gap else far
                distance[at, column] = to_ring
                trusted[at, column] = to_ring <= trusted_reach or (
                    above >= 0 and row - above <= trusted_gap
                )
            filled[row, column] = value
            trusted[row, column] = True
            if row - above > 1:  # a ring that changes its row covers two rows of one column
                ring_before[column] = above
            last[column] = row
    _continue_below(
        traced, last, ring_before, trusted_gap, trusted_reach, filled, distance, trusted
    )
    return filled, distance, trusted


@compiled
def _continue_below(
    traced: Float32[ndarray, "height width"],
    lowest_rows: Int64[ndarray, " width"],
    rows_before: Int64[ndarray, " width"],
    trusted_gap: float,
    trusted_reach: float,
    filled: Float32[ndarray, "height width"],
    distance: Float32[ndarray, "height width"],
    trusted: Bool[ndarray, "height width"],
) -> None:
    """Fill the pixels below the lowest ring in the last three arrays. Row -1: no such row."""
    height, width = traced.shape
    for column in range(width):
        lowest, before = lowest_rows[column], rows_before[column]
        if lowest < 0:
            continue
        value = traced[lowest, column]
        last_gap, slope, reach = 0, np.float32(0), trusted_reach
        if before >= 0:
            last_gap = lowest - before
            slope = max((value - traced[before, column]) / np.float32(last_gap), slope)
            reach = max(trusted_reach, min(float(last_gap), trusted_gap))
        for at in range(lowest + 1, height):
            rows = min(at - lowest, GROWTH_BELOW * last_gap)
            filled[at, column] = value + slope * np.float32(rows)
            distance[at, column] = at - lowest
            trusted[at, column] = at - lowest <= reach


@compiled
def bridge_rows(
    filled: Float32[ndarray, "height width"],
    distance: Float32[ndarray, "height width"],
    trusted: Bool[ndarray, "height width"],
    min_distance: float,
) -> Float32[ndarray, "height width"]:
    """Fill holes along their rows, linear between the trusted pixels on either side.

    A hole is a run of untrusted pixels whose first and last are at least `min_distance` from the
    nearest ring of their columns; nearer pixels lie beside a bent ring, such as the top one. A run
    is no hole if it lies above the rings of most of its columns and is more than twice as wide as
    the trusted part of its row: no ring reaches this space between near objects. A run without a
    trusted pixel on one side stays unchanged.

    Distances are 0 on rings, and infinite in columns without any.
    """
    height, width = filled.shape
    bridged = filled.copy()
    # Whether the column has a ring in this row or above, or no ring at all.
    is_below_top = np.zeros(width, dtype=np.bool_)
    for column in range(width):
        is_below_top[column] = np.isinf(distance[0, column])
    for row in range(height):
        # num_above: columns with all rings below, since the last trusted column
        max_gap, num_above = 0, 0
        for column in range(width):
            max_gap += MAX_HOLE_RATIO * trusted[row, column]
            is_below_top[column] |= distance[row, column] == 0
        left = -1
        for right in range(width):
            if not trusted[row, right]:
                num_above += not is_below_top[right]
                continue
            gap = right - left - 1
            if (
                left >= 0
                and gap > 0
                and (gap <= max_gap or 2 * num_above <= gap)
                and min(distance[row, left + 1], distance[row, right - 1]) >= min_distance
            ):
                start = filled[row, left]
                slope = (filled[row, right] - start) / np.float32(right - left)
                for at in range(left + 1, right):
                    bridged[row, at] = start + slope * np.float32(at - left)
            left, num_above = right, 0
    return bridged


@compiled
def smooth_rows(
    depth_m: Float32[ndarray, "height width"],
    distance: Float32[ndarray, "height width"],
    share: float,
) -> Float32[ndarray, "height width"]:
    """Average along rows, within `share` times each pixel's distance to the nearest ring."""
    height, width = depth_m.shape
    smooth = depth_m.copy()
    total = np.zeros(width + 1)  # float64: sums of a whole row
    for row in range(height):
        for column in range(width):
            total[column + 1] = total[column] + depth_m[row, column]
        for column in range(width):
            reach = int(share * distance[row, column])
            if reach > 0:
                start, end = max(column - reach, 0), min(column + reach + 1, width)
                smooth[row, column] = (total[end] - total[start]) / (end - start)
    return smooth


@compiled
def move_towards(
    depth_m: Float32[ndarray, "height width"],
    other_m: Float32[ndarray, "height width"],
    is_selected: Bool[ndarray, "height width"],
    tolerance: float,
    share: float,
) -> Float32[ndarray, "height width"]:
    """Move selected depths towards another map where the two differ by more than a tolerance.

    The tolerance is a share of the depth; a depth moves by `share` of the difference.
    """
    moved = depth_m.copy()
    for row in range(depth_m.shape[0]):
        for column in range(depth_m.shape[1]):
            depth = depth_m[row, column]
            difference = other_m[row, column] - depth
            if is_selected[row, column] and abs(difference) > np.float32(tolerance) * depth:
                moved[row, column] = depth + np.float32(share) * difference
    return moved

"""Ring numbers and the held-out-rings protocol, written out point by point in plain Python."""

import math

from tests.reference.parallax import hides


def ring_numbers(points):
    """Numbers up where the azimuth starts again: straight ahead if any point lies behind."""
    is_whole = any(point[0] < 0 for point in points)
    numbers, number, before = [], 0, None
    for x, y, *_ in points:
        azimuth = math.degrees(math.atan2(y, x))
        if is_whole and azimuth < 0:
            azimuth += 360
        if before is not None and azimuth - before < (-180 if is_whole else -30):
            number += 1
        numbers.append(number)
        before = azimuth
    return numbers


def laser_by_elevation(point, height_m, elevations_deg):
    """The laser whose cone, with its tip at `height_m` above the LiDAR's origin, is nearest."""
    x, y, z = point[:3]
    seen = math.degrees(math.atan2(z - height_m, math.hypot(x, y)))
    return min(range(len(elevations_deg)), key=lambda laser: abs(elevations_deg[laser] - seen))


def visible_truth(held_out_m, everything_m, base, growth):
    """Held-out depths that no point of the sweep hides from the camera; rows of numbers."""
    return [
        [
            depth if depth > 0 and not hides(everything_m, y, x, depth, base, growth) else 0.0
            for x, depth in enumerate(row)
        ]
        for y, row in enumerate(held_out_m)
    ]


def nearest_depths(depth_m, row, column):
    """Depths at the pixels with one that lie nearest to a pixel; several where there is a tie."""
    distances = {}
    for r, depths in enumerate(depth_m):
        for c, depth in enumerate(depths):
            if depth > 0:
                distances.setdefault((r - row) ** 2 + (c - column) ** 2, []).append(depth)
    return distances[min(distances)]

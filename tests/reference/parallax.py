"""Which returns a LiDAR sees past an edge that hides them from a camera, one pair at a time."""

import math


def hides(sweep_m, row, column, depth_m, base, growth):
    """Whether nearer returns lie on the way that parallax moves them, and on the other side."""
    shift = [
        (base[axis] + growth * (column, row)[axis]) / (1 + growth / depth_m) for axis in range(2)
    ]
    ahead = behind = False
    for y, depths in enumerate(sweep_m):
        for x, other_m in enumerate(depths):
            if other_m <= 0 or 1 / other_m <= 1.15 / depth_m:
                continue
            move = [each * (1 / other_m - 1 / depth_m) for each in shift]
            off = (x - column, y - row)
            along = off[0] * move[0] + off[1] * move[1]
            in_reach = all(
                min(step, 0) - slack <= way <= max(step, 0) + slack
                for step, way, slack in zip(move, off, (2, 3), strict=True)
            )
            ahead = ahead or (along >= 0 and in_reach and math.hypot(*move) >= 1)
            behind = behind or (along <= 0 and abs(off[0]) <= 4 and abs(off[1]) <= 7)
    return ahead and behind

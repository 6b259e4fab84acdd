"""Operations on point clouds, as they are told: one point after the other."""

import math

import numpy as np

Point = tuple[float, float, float]
Box = tuple[float, ...]


def squared_distance(a, b) -> np.float32:
    """In float32, as a sum from x to z: what the operations promise."""
    dx, dy, dz = (np.float32(p) - np.float32(q) for p, q in zip(a, b, strict=True))
    return dx * dx + dy * dy + dz * dz


def farthest_points(points: list[Point], count: int) -> list[int]:
    """Each time the point farthest from all taken, the first of several; starts with point 0."""
    taken: list[int] = []
    nearest = [np.float32(math.inf)] * len(points)
    for _ in range(count):
        taken.append(nearest.index(max(nearest)) if taken else 0)
        last = points[taken[-1]]
        nearest = [min(d, squared_distance(p, last)) for d, p in zip(nearest, points, strict=True)]
    return taken


def ball_query(points: list[Point], center: Point, radius: float, count: int):
    """Indices, filled up with the first, and how many they are before that."""
    limit = np.float32(radius) * np.float32(radius)
    near = [i for i, point in enumerate(points) if squared_distance(point, center) < limit]
    first = near[:count]
    filling = [first[0] if first else 0] * (count - len(first))
    return first + filling, len(first)


def three_nearest(points: list[Point], query: Point):
    """Indices and squared distances; 0 and infinity where there are no more points."""
    ranked = sorted((squared_distance(point, query), i) for i, point in enumerate(points))[:3]
    ranked += [(np.float32(math.inf), 0)] * (3 - len(ranked))
    return [i for _, i in ranked], [distance for distance, _ in ranked]


def depth_in_box(point: Point, box: Box, margin: float = 0.0) -> float:
    """How far inside a box a point lies, from its nearest face; negative outside."""
    x, y, z, length, width, height, yaw = box
    turned = complex(point[0] - x, point[1] - y) * complex(math.cos(yaw), -math.sin(yaw))
    along, across, up = turned.real, turned.imag, point[2] - z
    return margin + min(length / 2 - abs(along), width / 2 - abs(across), height / 2 - abs(up))


def points_in_box(points: list[Point], box: Box, margin: float = 0.0) -> list[int]:
    """Indices of those inside or on a face; none of a box without volume."""
    if not min(box[3:6]) > 0:
        return []
    return [i for i, point in enumerate(points) if depth_in_box(point, box, margin) >= 0]


def roi_points(inside: list[int], box_number: int, count: int, seed: int) -> list[int]:
    """The rule of drawing: the luckiest of many, in order; all of few, and repetitions."""
    salt = lowbias32(lowbias32(seed) + box_number)
    if len(inside) > count:
        by_luck = sorted(inside, key=lambda i: (lowbias32(salt ^ lowbias32(i)), i))
        return sorted(by_luck[:count])
    if not inside:
        return [0] * count
    shares = [lowbias32(salt + k) / 2**32 for k in range(len(inside), count)]
    repeated = [inside[int(share * len(inside))] for share in shares]
    return inside + repeated


def lowbias32(number: int) -> int:
    """Wellons's hash of 32 bits."""
    number %= 2**32
    number ^= number >> 16
    number = number * 0x7FEB352D % 2**32
    number ^= number >> 15
    number = number * 0x846CA68B % 2**32
    return number ^ (number >> 16)

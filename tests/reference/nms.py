"""Greedy non-maximum suppression, as it is told: two loops over plain lists."""

from collections.abc import Callable
from fractions import Fraction

Box = tuple[float, ...]


def nms(
    boxes: list[Box],
    scores: list[float],
    labels: list[int],
    iou: Callable[[Box, Box], float | Fraction],
    iou_threshold: float,
) -> list[int]:
    """Best first; of equal scores the one that stands first."""
    kept: list[int] = []
    for candidate in sorted(range(len(boxes)), key=lambda index: (-scores[index], index)):
        rivals = [index for index in kept if labels[index] == labels[candidate]]
        if not any(iou(boxes[rival], boxes[candidate]) > iou_threshold for rival in rivals):
            kept.append(candidate)
    return kept


def iou2d(a: Box, b: Box) -> Fraction:
    """Exact, of boxes x_min, y_min, x_max, y_max."""
    (ax0, ay0, ax1, ay1), (bx0, by0, bx1, by1) = (map(Fraction, box) for box in (a, b))
    width, height = min(ax1, bx1) - max(ax0, bx0), min(ay1, by1) - max(ay0, by0)
    shared = max(width, Fraction(0)) * max(height, Fraction(0))
    union = (ax1 - ax0) * (ay1 - ay0) + (bx1 - bx0) * (by1 - by0) - shared
    return shared / union if union else Fraction(0)

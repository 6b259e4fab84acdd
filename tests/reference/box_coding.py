"""Boxes by bins and the losses of the first stage, one box after the other in plain numbers."""

import math


def bin_code(offset: float, scope: float, width: float):
    """Bin of a centre's offset, and how far from the bin's middle it lies, in bins."""
    bins = [(-scope + k * width, -scope + (k + 1) * width) for k in range(round(2 * scope / width))]
    chosen = 0 if offset < -scope else len(bins) - 1
    for k, (low, high) in enumerate(bins):
        if low <= offset < high:
            chosen = k
    return chosen, (offset - sum(bins[chosen]) / 2) / width


def heading_code(yaw: float, count: int):
    """Bin whose middle is nearest, and how far from it the heading lies, in half bins."""
    width = 2 * math.pi / count
    differences = [math.remainder(yaw - k * width, 2 * math.pi) for k in range(count)]
    chosen = min(range(count), key=lambda k: abs(differences[k]))
    return chosen, differences[chosen] / (width / 2)


def focal(logit: float, is_class: bool, alpha: float, gamma: float) -> float:
    """Of one point and one class."""
    p = 1 / (1 + math.exp(-logit))
    if is_class:
        return -alpha * (1 - p) ** gamma * math.log(p)
    return -(1 - alpha) * p**gamma * math.log(1 - p)


def cross_entropy(scores: list[float], chosen: int) -> float:
    """Of a choice among several."""
    return math.log(sum(math.exp(score) for score in scores)) - scores[chosen]

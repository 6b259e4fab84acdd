"""Spatial propagation one pixel at a time, over lists of lists; the border repeats itself."""

import math


def propagate(depth, affinity_logits, confidence_logits, sparse, steps):
    """`affinity_logits` holds eight maps: the neighbours of a 3x3 window in reading order."""
    height, width = len(depth), len(depth[0])
    offsets = [(-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)]
    for _ in range(steps):
        mixed = [[0.0] * width for _ in range(height)]
        for y in range(height):
            for x in range(width):
                weights = [math.tanh(maps[y][x]) for maps in affinity_logits]
                total = max(1.0, sum(abs(weight) for weight in weights))
                weights = [weight / total for weight in weights]
                value = (1 - sum(weights)) * depth[y][x]
                for weight, (dy, dx) in zip(weights, offsets, strict=True):
                    row = min(max(y + dy, 0), height - 1)
                    column = min(max(x + dx, 0), width - 1)
                    value += weight * depth[row][column]
                if sparse[y][x] > 0:
                    confidence = 1 / (1 + math.exp(4 - confidence_logits[y][x]))
                    value = (1 - confidence) * value + confidence * sparse[y][x]
                mixed[y][x] = value
        depth = mixed
    return depth

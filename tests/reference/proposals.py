"""The second stage's tasks, as they are told: loops over lists."""

import math
from fractions import Fraction


def upright_iou(a, b) -> float:
    """3D IoU of boxes x, y, z, length, width, height, 0: exact."""
    assert a[6] == b[6] == 0, "these are not turned"
    shared = volume_a = volume_b = Fraction(1)
    for axis in range(3):
        (at, size), (bt, other) = ((Fraction(box[axis]), Fraction(box[axis + 3])) for box in (a, b))
        top, bottom = min(at + size / 2, bt + other / 2), max(at - size / 2, bt - other / 2)
        shared *= max(top - bottom, Fraction(0))
        volume_a, volume_b = volume_a * size, volume_b * other
    return float(shared / (volume_a + volume_b - shared))


def assigned(proposals, truths):
    """Object and IoU of each proposal."""
    pairs = []
    for proposal in proposals:
        ious = [upright_iou(proposal, truth) for truth in truths]
        pairs.append((ious.index(max(ious)), max(ious)) if ious else (-1, 0.0))
    return pairs


def pools(proposals, truths, foreground=0.55, background=0.45, easy=0.05):
    """What may be drawn: (proposal, object) as foreground, easy and hard background."""
    own = assigned(proposals, truths)
    extras = set()
    for t, truth in enumerate(truths):
        ious = [upright_iou(proposal, truth) for proposal in proposals]
        if ious and max(ious) > 0:
            extras.add((ious.index(max(ious)), t))
    pairs = {(p, t): iou for p, (t, iou) in enumerate(own)}
    strong = {pair for pair, iou in pairs.items() if iou >= foreground}
    weak = {pair: iou for pair, iou in pairs.items() if iou < background and pair not in extras}
    return (
        strong | extras,
        {pair for pair, iou in weak.items() if iou < easy},
        {pair for pair, iou in weak.items() if iou >= easy},
    )


def smooth_l1(x: float) -> float:
    """With a knee at 1."""
    return 0.5 * x * x if abs(x) <= 1 else abs(x) - 0.5


def box_loss(predicted, target, ious, threshold=0.55, size_weight=3.0):
    """Location, size and rotation of one batch, and their weighted sum."""
    rows = [
        [smooth_l1(p - t) for p, t in zip(given, wanted, strict=True)]
        for given, wanted, iou in zip(predicted, target, ious, strict=True)
        if iou >= threshold
    ]
    if not rows:
        return 0.0, 0.0, 0.0, 0.0
    location, size, rotation = (
        sum(sum(row[part]) for row in rows) / sum(len(row[part]) for row in rows)
        for part in (slice(0, 3), slice(3, 6), slice(6, 7))
    )
    return location + size_weight * size + rotation, location, size, rotation


def confidence_loss(scores, ious, positive=0.6, negative=0.45):
    """Binary cross entropy of scores between 0 and 1."""
    terms = [
        -math.log(score) if iou >= positive else -math.log(1 - score)
        for score, iou in zip(scores, ious, strict=True)
        if iou >= positive or iou <= negative
    ]
    return sum(terms) / len(terms) if terms else 0.0

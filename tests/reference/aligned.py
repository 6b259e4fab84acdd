"""Task-aligned assignment and the losses around it, place by place, in plain Python."""

import math

from tests.reference.ssd import area, covered, iou


def assign(scores, boxes, middles, truth, classes, *, alpha, beta, cells):
    """Object and quality of each place; None and 0 where there is nothing to find."""
    aligned = []
    for box, label in zip(truth, classes, strict=True):
        row = []
        for said, found in zip(scores, boxes, strict=True):
            row.append(max(said[label], 1e-6) ** alpha * (iou(box, found) + 0.05) ** beta)
        inside = [contains(box, middle) for middle in middles]
        if not any(inside):
            x, y = (box[0] + box[2]) / 2, (box[1] + box[3]) / 2
            away = [(x - middle[0]) ** 2 + (y - middle[1]) ** 2 for middle in middles]
            inside[away.index(min(away))] = True
        aligned.append([each if is_in else 0.0 for each, is_in in zip(row, inside, strict=True)])
    owners = [None] * len(boxes)
    best = [-1.0] * len(boxes)
    for number, row in enumerate(aligned):
        chosen = sorted(range(len(row)), key=lambda place: -row[place])[:cells]
        for place in chosen:
            overlap = iou(truth[number], boxes[place])
            if row[place] > 0 and overlap > best[place]:
                owners[place], best[place] = number, overlap
    qualities = [0.0] * len(boxes)
    for number, row in enumerate(aligned):
        own = [place for place, owner in enumerate(owners) if owner == number]
        if own:
            highest = max(row[place] for place in own)
            overlap = max([0.1, *(iou(truth[number], boxes[place]) for place in own)])
            for place in own:
                qualities[place] = row[place] / highest * overlap
    return owners, qualities


def contains(box, middle):
    return box[0] <= middle[0] <= box[2] and box[1] <= middle[1] <= box[3]


def decode(logits, places):
    """Corners of boxes, of distances that are means of distributions in strides."""
    found = []
    for row, (x, y, wide, high) in zip(logits, places, strict=True):
        steps = len(row) // 4
        distances = []
        for side in range(4):
            weights = [math.exp(value) for value in row[side * steps : (side + 1) * steps]]
            distances.append(sum(k * w for k, w in enumerate(weights)) / sum(weights))
        left, top, right, bottom = distances
        found.append((x - left * wide, y - top * high, x + right * wide, y + bottom * high))
    return found


def distribution_cost(logits, place, box):
    """Mean over the sides of the cross entropy of the two steps around the true distance."""
    steps = len(logits) // 4
    x, y, wide, high = place
    true = ((x - box[0]) / wide, (y - box[1]) / high, (box[2] - x) / wide, (box[3] - y) / high)
    total = 0.0
    for side, exact in enumerate(true):
        row = logits[side * steps : (side + 1) * steps]
        normalizer = math.log(sum(math.exp(value) for value in row))
        distance = min(max(exact, 0.0), steps - 1 - 1e-3)
        lower = math.floor(distance)
        share = distance - lower
        total -= (1 - share) * (row[lower] - normalizer) + share * (row[lower + 1] - normalizer)
    return total / 4


def generalized_iou(a, b):
    union = area(a) + area(b) - iou(a, b) * (area(a) + area(b)) / (1 + iou(a, b))
    hull = (max(a[2], b[2]) - min(a[0], b[0])) * (max(a[3], b[3]) - min(a[1], b[1]))
    return iou(a, b) - (hull - union) / hull


def class_cost(logit, wanted, kind):
    score = 1 / (1 + math.exp(-logit))
    entropy = -(wanted * math.log(score) + (1 - wanted) * math.log(1 - score))
    if kind == "quality_focal":
        return abs(wanted - score) ** 2 * entropy
    return wanted * entropy if wanted > 0 else 0.75 * score**2 * entropy


def loss(frames, places, *, kind, weights, image_weights):
    """Three terms of a batch.

    Frames: (class logits, box logits, boxes, classes, ignored boxes, their classes, owners,
    qualities).
    """
    class_sum, box_sum, distribution_sum, number = 0.0, 0.0, 0.0, 0.0
    for frame, factor in zip(frames, image_weights, strict=True):
        class_logits, box_logits, truth, classes, ignored, flags, owners, qualities = frame
        found = decode(box_logits, places)
        number += factor * sum(qualities)
        for place, (said, owner) in enumerate(zip(class_logits, owners, strict=True)):
            for label, logit in enumerate(said):
                is_wanted = owner is not None and classes[owner] == label
                wanted = qualities[place] if is_wanted else 0.0
                is_ignored = any(
                    flag[label]
                    and (contains(region, places[place]) or covered(found[place], region) >= 0.5)
                    for region, flag in zip(ignored, flags, strict=True)
                )
                if wanted > 0 or not is_ignored:
                    class_sum += factor * class_cost(logit, wanted, kind)
            if owner is not None:
                factored = factor * qualities[place]
                box_sum += factored * (1 - generalized_iou(found[place], truth[owner]))
                distribution_sum += factored * distribution_cost(
                    box_logits[place], places[place], truth[owner]
                )
    number = max(number, 1.0)
    sums = (class_sum, box_sum, distribution_sum)
    return [weight * each / number for weight, each in zip(weights, sums, strict=True)]

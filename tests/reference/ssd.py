"""SSD's priors, matching and loss (Liu et al. 2016) prior by prior, in plain Python."""

import math


def priors(sizes, ratios, maps, image_size):
    """Clipped corners of every prior: map by map, row by row, then by shape."""
    height, width = image_size
    found = []
    for number, (rows, columns) in enumerate(maps):
        size, following = sizes[number], sizes[number + 1]
        shapes = [(size, size), (math.sqrt(size * following), math.sqrt(size * following))]
        for ratio in ratios[number]:
            shapes.append((size * math.sqrt(ratio), size / math.sqrt(ratio)))
            shapes.append((size / math.sqrt(ratio), size * math.sqrt(ratio)))
        for row in range(rows):
            for column in range(columns):
                x = (column + 0.5) * width / columns - 0.5
                y = (row + 0.5) * height / rows - 0.5
                for wide, high in shapes:
                    found.append(
                        (
                            max(x - wide / 2, 0),
                            max(y - high / 2, 0),
                            min(x + wide / 2, width - 1),
                            min(y + high / 2, height - 1),
                        )
                    )
    return found


def iou(a, b):
    shared = 1.0
    for low, high in ((0, 2), (1, 3)):
        shared *= max(min(a[high], b[high]) - max(a[low], b[low]), 0)
    union = area(a) + area(b) - shared
    return shared / union if union > 0 else 0.0


def area(box):
    return max(box[2] - box[0], 0) * max(box[3] - box[1], 0)


def covered(box, region):
    """Share of a box within a region."""
    shared = 1.0
    for low, high in ((0, 2), (1, 3)):
        shared *= max(min(box[high], region[high]) - max(box[low], region[low]), 0)
    return shared / max(area(box), 1e-9)


def match(prior_boxes, truth_boxes, match_iou):
    """The object of each prior, or None."""
    if not truth_boxes:
        return [None] * len(prior_boxes)
    matches = []
    for prior in prior_boxes:
        overlaps = [iou(prior, box) for box in truth_boxes]
        best = max(range(len(overlaps)), key=lambda index: (overlaps[index], -index))
        matches.append(best if overlaps[best] >= match_iou else None)
    for number, box in enumerate(truth_boxes):
        overlaps = [iou(prior, box) for prior in prior_boxes]
        matches[max(range(len(overlaps)), key=lambda index: (overlaps[index], -index))] = number
    return matches


def loss(logits, offsets, prior_boxes, frames, *, match_iou, per_positive, ignored_share):
    """Classification and box loss of a batch; frames: (boxes, classes, ignored regions)."""
    classification, boxes, positives = 0.0, 0.0, 0
    for frame_logits, frame_offsets, (truth, classes, ignored) in zip(
        logits, offsets, frames, strict=True
    ):
        matches = match(prior_boxes, truth, match_iou)
        negatives = []
        count = sum(each is not None for each in matches)
        positives += count
        for said, moved, prior, found in zip(
            frame_logits, frame_offsets, prior_boxes, matches, strict=True
        ):
            if found is not None:
                classification += cross_entropy(said, classes[found] + 1)
                boxes += sum(
                    smooth_l1(a - b)
                    for a, b in zip(moved, encode(truth[found], prior), strict=True)
                )
            elif not any(covered(prior, region) >= ignored_share for region in ignored):
                negatives.append(cross_entropy(said, 0))
        classification += sum(sorted(negatives, reverse=True)[: math.floor(per_positive * count)])
    return classification / max(positives, 1), boxes / max(positives, 1)


def cross_entropy(logits, wanted):
    highest = max(logits)
    total = sum(math.exp(each - highest) for each in logits)
    return math.log(total) + highest - logits[wanted]


def smooth_l1(difference):
    return 0.5 * difference**2 if abs(difference) < 1 else abs(difference) - 0.5


def encode(box, prior):
    wide, high = prior[2] - prior[0], prior[3] - prior[1]
    return (
        ((box[0] + box[2]) / 2 - (prior[0] + prior[2]) / 2) / wide / 0.1,
        ((box[1] + box[3]) / 2 - (prior[1] + prior[3]) / 2) / high / 0.1,
        math.log((box[2] - box[0]) / wide) / 0.2,
        math.log((box[3] - box[1]) / high) / 0.2,
    )

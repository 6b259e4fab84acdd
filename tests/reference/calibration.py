"""Calibration errors, LRP and isotonic regression by their definitions, in plain loops."""

import math


def outcomes(frame, threshold):
    """(place, is true, overlap) of the detections of a `kitti_object.Frame` that count."""
    left = [j for j, each in enumerate(frame.detections) if not each.score < threshold]
    taken, found = set(), {}
    for i, kind in enumerate(frame.truth_kinds):
        if kind == "none":
            continue
        free = [j for j in left if j not in taken and frame.overlap(j, i) > frame.minimum]
        normal = [j for j in free if frame.detection_kinds[j] == "normal"]
        small = [j for j in free if frame.detection_kinds[j] == "small"]
        if normal:
            best = max(normal, key=lambda j: frame.overlap(j, i))
            taken.add(best)
            if kind == "valid":
                found[best] = frame.overlap(best, i)
        elif small:
            taken.add(small[0])
    regions = [each for each in frame.truths if each.name == "dontcare"]
    counted = []
    for j in left:
        if j in found:
            counted.append((j, True, found[j]))
        elif frame.detection_kinds[j] == "normal" and j not in taken:
            cover = [
                frame.evaluation.overlap(
                    frame.detections[j], region, frame.metric, over_detection=True
                )
                for region in regions
            ]
            if not any(each > frame.minimum for each in cover):
                counted.append((j, False, 0.0))
    return counted


def expected_error(scores, targets, num_bins):
    """Mean over bins of |mean score - mean target|, by their counts."""
    bins = {}
    for score, target in zip(scores, targets, strict=True):
        number = min(math.floor(score * num_bins), num_bins - 1)
        bins.setdefault(number, []).append((score, target))
    distances = 0.0
    for held in bins.values():
        score = sum(each[0] for each in held) / len(held)
        target = sum(each[1] for each in held) / len(held)
        distances += len(held) * abs(score - target)
    return distances / len(scores) if len(scores) else None


def optimal_lrp(frames, minimum):
    """The least LRP error over all scores of the frames' detections, and finding nothing."""
    n_gt = sum(frame.truth_kinds.count("valid") for frame in frames)
    errors = [1.0]
    for threshold in {each.score for frame in frames for each in frame.detections}:
        counted = [entry for frame in frames for entry in outcomes(frame, threshold)]
        overlaps = [overlap for _, is_true, overlap in counted if is_true]
        num_false = sum(not is_true for _, is_true, _ in counted)
        misses = n_gt - len(overlaps)
        misplaced = sum((1 - overlap) / (1 - minimum) for overlap in overlaps)
        errors.append((misplaced + num_false + misses) / (len(overlaps) + num_false + misses))
    return min(errors)


def isotonic(targets):
    """Least squares in order of the scores: the largest of the least means (Barlow et al. 1972)."""
    count = len(targets)

    def mean(first, last):
        return sum(targets[first : last + 1]) / (last + 1 - first)

    return [
        max(min(mean(first, last) for last in range(i, count)) for first in range(i + 1))
        for i in range(count)
    ]

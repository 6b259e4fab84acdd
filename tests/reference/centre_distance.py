"""nuScenes' detection scores with KITTI's rules for who counts: slow, plain loops over text.

A frame is a pair (label text, result text); `repeats` says how often each frame counts.
"""

import math

from tests.reference.kitti_object import detection_kind, parse, rectangle, truth_kind

DISTANCES = (0.5, 1, 2, 4)


def has_3d(box):
    return min(box.h, box.w, box.l) > 0 and -1000 not in (box.x, box.y, box.z)


def distance(a, b):
    if not (has_3d(a) and has_3d(b)):
        return math.inf
    dx, dz = a.x - b.x, a.z - b.z
    return math.sqrt(dx * dx + dz * dz)  # rounded as in the code: some distances equal a limit


def is_in_region(found, truths, minimum):
    """Whether a DontCare region covers the detection in space, KITTI's rule for unlabelled ones."""
    for region in truths:
        if region.name == "dontcare" and min(region.w, region.l, found.h, found.w, found.l) > 0:
            ground = rectangle(found).intersection(rectangle(region)).area
            height = min(found.y, region.y) - max(found.y - found.h, region.y - region.h)
            if ground * max(0, height) / (found.h * found.w * found.l) > minimum:
                return True
    return False


def ranked(frames, name, level):
    """Detections of the class with their frames, highest score first, of equal ones the last."""
    listed = []
    for number, (_, results) in enumerate(frames):
        for found in parse(results, with_score=True):
            if found.name == name.lower() and detection_kind(found, name.lower(), level) != "small":
                listed.append((found.score, len(listed), number, found))
    return [(number, found) for _, _, number, found in sorted(listed, reverse=True)]


def match(frames, name, level, limit, repeats=None, minimum=0.7):
    """Number of objects; each counting detection: score, its truth or None, itself."""
    truths = [parse(labels, with_score=False) for labels, _ in frames]
    repeats = repeats or [1] * len(frames)
    kinds = [[truth_kind(each, name.lower(), level) for each in frame] for frame in truths]
    n_gt = sum(kind.count("valid") * times for kind, times in zip(kinds, repeats, strict=True))
    taken, counted = set(), []
    for number, found in ranked(frames, name, level):
        nearest, least = None, limit
        for i, truth in enumerate(truths[number]):
            is_free = kinds[number][i] != "none" and (number, i) not in taken
            if is_free and distance(found, truth) < least:
                nearest, least = i, distance(found, truth)
        if nearest is None:
            if is_in_region(found, truths[number], minimum):
                continue
            counted += [(found.score, None, found)] * repeats[number]
            continue
        taken.add((number, nearest))
        if kinds[number][nearest] == "valid":
            counted += [(found.score, truths[number][nearest], found)] * repeats[number]
    return n_gt, counted


def points(n_gt, counted):
    """Recall, precision and score after each detection."""
    curve, tp = [], 0
    for place, (score, truth, _) in enumerate(counted):
        tp += truth is not None
        curve.append((tp / n_gt, tp / (place + 1), score))
    return curve


def interpolate(x, known):
    """Value at x of the line through known (x, y), rising in x; of equal x the last y."""
    if x <= known[0][0] and x != known[-1][0]:
        before = [y for at, y in known if at == x]
        return before[-1] if before else known[0][1]
    last = max(place for place, (at, _) in enumerate(known) if at <= x)
    if last == len(known) - 1:
        return known[last][1]
    (x0, y0), (x1, y1) = known[last], known[last + 1]
    return y0 + (x - x0) * (y1 - y0) / (x1 - x0)


def positions(curve):
    """Recall positions 0.11 to 1 that the curve reaches."""
    return [0.01 * k for k in range(11, 101) if 0.01 * k <= curve[-1][0]]


def average_precision(n_gt, counted):
    curve = points(n_gt, counted)
    if not any(truth for _, truth, _ in counted):
        return 0
    known = [(recall, precision) for recall, precision, _ in curve]
    reached = [interpolate(x, known) for x in positions(curve)]
    return 100 * sum(max(0, precision - 0.1) for precision in reached) / 90 / 0.9


def errors_of(found, truth):
    shared = math.prod(min(getattr(found, side), getattr(truth, side)) for side in "hwl")
    volumes = found.h * found.w * found.l + truth.h * truth.w * truth.l
    turn = min(abs(found.ry - truth.ry + 2 * math.pi * k) for k in range(-3, 4))
    return distance(found, truth), 1 - shared / (volumes - shared), turn


def mean_errors(n_gt, counted):
    """Translation, scale and orientation error; None if no recall above 0.1 is reached."""
    curve = points(n_gt, counted)
    if not curve or not positions(curve):
        return None
    at_recall = [(recall, score) for recall, _, score in curve]
    matched = [(score, errors_of(found, truth)) for score, truth, found in counted if truth]
    means = []
    for column in range(3):
        so_far = []
        for place in range(len(matched)):
            values = [errors[column] for _, errors in matched[: place + 1]]
            so_far.append((matched[place][0], sum(values) / len(values)))
        rising = so_far[::-1]
        at_positions = [interpolate(interpolate(x, at_recall), rising) for x in positions(curve)]
        means.append(sum(at_positions) / len(at_positions))
    return means


def scores(frames, name, level, repeats=None, minimum=0.7):
    """Mean AP, AP by distance, errors at 2 m; None if no object counts."""
    matches = [match(frames, name, level, limit, repeats, minimum) for limit in DISTANCES]
    if matches[0][0] == 0:
        return None
    precisions = [average_precision(*each) for each in matches]
    return sum(precisions) / 4, precisions, mean_errors(*matches[2])

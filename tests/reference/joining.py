"""Slow references of joining, in plain loops."""


def iou(a, b):
    width = min(a[2], b[2]) - max(a[0], b[0])
    height = min(a[3], b[3]) - max(a[1], b[1])
    shared = max(width, 0) * max(height, 0)
    union = (a[2] - a[0]) * (a[3] - a[1]) + (b[2] - b[0]) * (b[3] - b[1]) - shared
    return shared / union if union > 0 else 0.0


def best_partner(box, name, others, *, same):
    """IoU and score of the other detector's box with the largest product; zeros without one.

    Boxes are (name, score, corners).
    """
    best, found = 0.0, (0.0, 0.0)
    for other_name, score, corners in others:
        if (other_name == name) == same and iou(box, corners) * score > best:
            best, found = iou(box, corners) * score, (iou(box, corners), score)
    return found


def match(sweep, image, min_iou):
    """Partner in the image of each box of the sweep; -1: none. The surest chooses first."""
    partners, taken = [-1] * len(sweep), set()
    for row in sorted(range(len(sweep)), key=lambda row: -sweep[row][1]):
        name, _, corners = sweep[row]
        best = -1.0
        for column, (other_name, score, other) in enumerate(image):
            if column in taken or other_name != name or iou(corners, other) < min_iou:
                continue
            if iou(corners, other) * score > best:
                partners[row], best = column, iou(corners, other) * score
        taken.add(partners[row])
    return partners

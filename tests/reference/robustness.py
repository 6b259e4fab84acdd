"""The measures of the bench, written out with loops over a plain table.

A table: {kind: {severity: score}}. `highest` is the perfect score, or None for an error.
"""


def errors(levels, highest):
    found = []
    for severity in sorted(levels):
        if highest is None:
            found.append(levels[severity])
        else:
            found.append(highest - levels[severity])
    return found


def mpc(table):
    total = 0.0
    for levels in table.values():
        of_kind = 0.0
        for score in levels.values():
            of_kind += score / len(levels)
        total += of_kind / len(table)
    return total


def rr(levels, clean, highest):
    mean = 0.0
    for score in levels.values():
        mean += score / len(levels)
    if highest is None:
        return None if mean == 0 else clean / mean
    return None if clean == 0 else mean / clean


def ce(levels, baseline, highest):
    ours, theirs = 0.0, 0.0
    for error in errors(levels, highest):
        ours += error
    for error in errors(baseline, highest):
        theirs += error
    return None if theirs == 0 else ours / theirs


def mean_or_none(values):
    total = 0.0
    for value in values:
        if value is None:
            return None
        total += value
    return total / len(values)


def worst(table, highest):
    """Kind, severity and score of the first of the worst."""
    found = None
    for kind, levels in table.items():
        for severity, score in levels.items():
            is_worse = found is None or (score > found[2] if highest is None else score < found[2])
            if is_worse:
                found = (kind, severity, score)
    return found


def gap(score, healthy, highest):
    if not healthy:
        return None
    best = min(healthy) if highest is None else max(healthy)
    return best - score if highest is None else score - best

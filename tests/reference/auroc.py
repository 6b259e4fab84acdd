"""AUROC by comparing everybody with everybody."""


def auroc(positives, negatives):
    """Share of pairs in which the positive is higher; half of those in which both are the same."""
    wins = 0.0
    for positive in positives:
        for negative in negatives:
            if positive > negative:
                wins += 1
            elif positive == negative:
                wins += 0.5
    pairs = len(positives) * len(negatives)
    return wins / pairs if pairs else None

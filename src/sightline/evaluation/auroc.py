"""Area under the ROC curve: how well a number tells two groups apart, whatever the threshold."""

import numpy as np
from jaxtyping import Float, Int64


def auroc(
    positives: Int64[np.ndarray, " levels"], negatives: Int64[np.ndarray, " levels"]
) -> float | None:
    """Probability that a random positive stands at a higher level than a random negative.

    Hanley and McNeil 1982, "The meaning and use of the area under a ROC curve"; one at the same
    level counts half. Exact, for groups of any size, as only counts are kept.

    Args:
        positives: How many stand at each level, the lowest first.
        negatives: Likewise; together fewer than 2**31 each, so that the pairs can be counted.

    Returns:
        0.5 where the number says nothing; None where a group is empty.
    """
    num_pairs = int(positives.sum()) * int(negatives.sum())
    if num_pairs == 0:
        return None
    twice_below = 2 * np.cumsum(negatives) - negatives
    return int(positives @ twice_below) / (2 * num_pairs)


def auroc_of_values(
    positives: Float[np.ndarray, " num_positives"], negatives: Float[np.ndarray, " num_negatives"]
) -> float | None:
    """`auroc` of two groups of finite values."""
    levels, level = np.unique(np.concatenate((positives, negatives)), return_inverse=True)
    groups = level[: len(positives)], level[len(positives) :]
    above, below = (np.bincount(group, minlength=len(levels)) for group in groups)
    return auroc(above, below)

"""Area under the ROC curve (AUROC): separation of two groups, independent of a threshold."""

import numpy as np
from jaxtyping import Float, Int64


def auroc(
    positives: Int64[np.ndarray, " levels"], negatives: Int64[np.ndarray, " levels"]
) -> float | None:
    """Compute the probability that a random positive has a higher level than a random negative.

    Hanley and McNeil 1982, "The meaning and use of the area under a ROC curve"; equal levels count
    half. Exact, for groups of any size, as only counts are kept.

    Args:
        positives: Number of positives at each level, from the lowest.
        negatives: Number of negatives; both totals must be below 2**31, so that the pairs can be
            counted.

    Returns:
        0.5 without separation; None if a group is empty.
    """
    num_pairs = int(positives.sum()) * int(negatives.sum())
    if num_pairs == 0:
        return None
    twice_below = 2 * np.cumsum(negatives) - negatives
    return int(positives @ twice_below) / (2 * num_pairs)


def auroc_of_values(
    positives: Float[np.ndarray, " num_positives"], negatives: Float[np.ndarray, " num_negatives"]
) -> float | None:
    """Compute `auroc` of two groups of finite values."""
    levels, level = np.unique(np.concatenate((positives, negatives)), return_inverse=True)
    groups = level[: len(positives)], level[len(positives) :]
    above, below = (np.bincount(group, minlength=len(levels)) for group in groups)
    return auroc(above, below)

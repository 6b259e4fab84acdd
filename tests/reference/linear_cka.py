"""Linear centred kernel alignment from centred Gram matrices (Kornblith et al. 2019, Eq. 3)."""

import numpy as np


def linear_cka(first: np.ndarray, second: np.ndarray) -> float | None:
    """HSIC of both, by the root of the product of their own; None of constant features."""
    count = len(first)
    centring = np.eye(count) - 1 / count
    grams = [
        centring @ (each.astype(np.float64) @ each.astype(np.float64).T) @ centring
        for each in (first, second)
    ]
    hsic = [[float(np.sum(a * b)) for b in grams] for a in grams]
    own = np.sqrt(hsic[0][0] * hsic[1][1])
    return hsic[0][1] / own if own > 1e-12 else None

"""Compiled kernels for adding rows to rows, and weighted sums of rows, without torch."""

from jaxtyping import Float, Int64
from numpy import ndarray

from sightline.ops.compiled import compiled


@compiled
def add_to_rows(
    values: Float[ndarray, "n channels"],
    rows: Int64[ndarray, " n"],
    total: Float[ndarray, "m channels"],
) -> None:
    """Add each row of `values` to the row of `total` given by `rows`, in order."""
    for i in range(rows.size):
        value, target = values[i], total[rows[i]]
        for c in range(value.size):
            target[c] += value[c]


@compiled
def weighted_sums(
    values: Float[ndarray, "m channels"],
    rows: Int64[ndarray, "n 3"],
    weights: Float[ndarray, "n 3"],
    sums: Float[ndarray, "n channels"],
) -> None:
    """Write weighted sums of three rows of `values`."""
    for i in range(rows.shape[0]):
        a, b, c = values[rows[i, 0]], values[rows[i, 1]], values[rows[i, 2]]
        wa, wb, wc = weights[i, 0], weights[i, 1], weights[i, 2]
        out = sums[i]
        for k in range(out.size):
            out[k] = wa * a[k] + wb * b[k] + wc * c[k]


@compiled
def add_weighted_to_rows(
    values: Float[ndarray, "n channels"],
    rows: Int64[ndarray, "n 3"],
    weights: Float[ndarray, "n 3"],
    total: Float[ndarray, "m channels"],
) -> None:
    """Add each row of `values`, times three weights, to the rows given by `rows`, in order."""
    for i in range(rows.shape[0]):
        value = values[i]
        for j in range(3):
            weight, target = weights[i, j], total[rows[i, j]]
            for k in range(value.size):
                target[k] += weight * value[k]

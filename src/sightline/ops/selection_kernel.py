"""Compiled kernel of Hoare's selection."""

from jaxtyping import Int64, Shaped
from numpy import ndarray

from sightline.ops.compiled import compiled


@compiled
def select_smallest(
    values: Shaped[ndarray, " n"], order: Int64[ndarray, " m"], first: int, last: int, nth: int
) -> None:
    """Reorder `order[first..last]` so that no value before place `nth` exceeds one after it.

    Hoare 1961 (FIND): linear time on average, and deterministic.

    Args:
        values: Values to compare; unchanged. No NaN.
        order: Indices into `values`.
        first: First place that may change.
        last: Last place that may change, inclusive.
        nth: Place that gets the value that it would have after sorting.
    """
    while first < last:
        pivot = values[order[(first + last) // 2]]
        i, j = first, last
        while i <= j:
            while values[order[i]] < pivot:
                i += 1
            while values[order[j]] > pivot:
                j -= 1
            if i <= j:
                order[i], order[j] = order[j], order[i]
                i += 1
                j -= 1
        if nth <= j:
            last = j
        elif nth >= i:
            first = i
        else:
            return

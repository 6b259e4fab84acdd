"""Indices of samples in data sets."""

from contextlib import suppress
from operator import index

import numpy as np

from sightline.geometry.arguments import shown


def sample_place(place: object, length: int) -> int:
    """Normalise the index of a sample, of any integer type; negative from the end.

    Args:
        place: The requested index.
        length: Length of the data set.

    Raises:
        IndexError: There is no such sample.
        TypeError: The index is no whole number.
    """
    if not isinstance(place, bool | np.bool_):
        with suppress(TypeError):
            number = index(place)  # type: ignore[arg-type]  # TypeError of anything else
            if not -length <= number < length:
                ends = f"; they are numbered from 0 to {length - 1}" if length else ""
                raise IndexError(f"a data set of {length} samples has no sample {number}{ends}")
            return number % length
    remedy = "take several one by one: [dataset[place] for place in range(start, stop)]"
    if isinstance(place, str):
        remedy = f"look its place up: dataset.sample_ids.index({shown(place)})"
    raise TypeError(f"a data set is asked for a sample by its number, got {shown(place)}; {remedy}")

"""Expanded ground truth: the training target of the Shift-Convolution branch."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache, reduce
from typing import Literal, get_args

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import pad

Variant = Literal["repeated", "near_wins", "literal"]
_GROWTH_PX = 3  # one step of the repeated variants reaches the eight neighbours


@dataclass(frozen=True, kw_only=True)
class ExpansionConfig:
    """Expansion of ground truth: maximum, then median filter (Yu and Kee 2021, section 2.2)."""

    variant: Variant = "repeated"
    """repeated: 3x3 maxima on empty pixels until none is left; near_wins: the same with minima,
    so that objects do not shrink; literal: one maximum over all pixels, which leaves gaps."""
    literal_px: int = 15
    """Side of the literal variant's window."""
    median_px: int = 5
    """Side of the median's window; 1: no median."""

    def __post_init__(self) -> None:
        """Check the variant and the windows."""
        if self.variant not in get_args(Variant):
            raise ValueError(
                f"variant must be one of {', '.join(get_args(Variant))}, got {self.variant!r}"
            )
        for name, side_px in (("literal_px", self.literal_px), ("median_px", self.median_px)):
            if side_px < 1 or side_px % 2 == 0:
                raise ValueError(
                    f"{name} must be odd, so that a window has a centre, got {side_px}"
                )


def expand_depth(
    depth_m: Float[Tensor, "batch 1 height width"], config: ExpansionConfig = ExpansionConfig()
) -> Float[Tensor, "batch 1 height width"]:
    """Fill the gaps of depth maps [m; 0 = none] from their surroundings, then smooth.

    The paper names the filters, not their sizes. In the repeated variants a measured pixel keeps
    its depth; an empty one gets the largest (near_wins: the smallest) of the measured depths
    nearest to it, by max(|rows|, |columns|). A map without any depth stays empty; any other has no
    gap left. The literal variant may leave gaps, which count as depth 0 in its median.

    At the border the maximum uses the pixels inside; the median repeats the outermost pixels.
    Gives no gradient. Each step of the repeated variants synchronises a GPU to find the rows with
    gaps; the number of steps is the largest distance of an empty pixel from a measured one.
    """
    depth_m = depth_m.detach()
    # Empty pixels have the lowest score, so that any depth wins the maximum.
    sign = -1 if config.variant == "near_wins" else 1
    scores = torch.where(depth_m > 0, sign * depth_m, -torch.inf)
    if config.variant == "literal":
        scores = _window_maximum(scores, config.literal_px)
    else:
        scores = _grow_until_full(scores)
    expanded = torch.where(scores.isfinite(), sign * scores, 0.0)
    return expanded if config.median_px == 1 else _window_median(expanded, config.median_px)


def _grow_until_full(
    scores: Float[Tensor, "batch 1 height width"],
) -> Float[Tensor, "batch 1 height width"]:
    scores = scores.clone()
    has_any = scores.isfinite().any(dim=3).any(dim=2)[..., None, None]
    first, last = 0, scores.shape[2] - 1
    while first <= last:
        # Only the rows that still have gaps, and their neighbours: often just the sky is left.
        start = max(first - 1, 0)
        band = scores[:, :, start : last + 2]
        band[:] = torch.where(band.isneginf(), _window_maximum(band, _GROWTH_PX), band)
        rows = (band.isneginf() & has_any).any(dim=3).any(dim=0)[0].nonzero()[:, 0].tolist()
        first, last = (start + rows[0], start + rows[-1]) if rows else (1, 0)
    return scores


def _window_maximum(
    scores: Float[Tensor, "batch 1 height width"], side_px: int
) -> Float[Tensor, "batch 1 height width"]:
    # Whole shifted maps, rows first, then columns: on a CPU 50 times as fast as max_pool2d.
    half, (height, width) = side_px // 2, scores.shape[2:]
    padded = pad(scores, (0, 0, half, half), value=-torch.inf)
    scores = reduce(torch.maximum, (padded[:, :, y : y + height] for y in range(side_px)))
    padded = pad(scores, (half, half), value=-torch.inf)
    return reduce(torch.maximum, (padded[..., x : x + width] for x in range(side_px)))


def _window_median(
    depth_m: Float[Tensor, "batch 1 height width"], side_px: int
) -> Float[Tensor, "batch 1 height width"]:
    """Median of each window, by a fixed order of minima and maxima of whole shifted maps.

    The windows' columns are sorted first, once for all windows that share them; the sorted columns
    then go through a network of comparators. Exact, and on a CPU some 15 times as fast as
    `median` over unfolded windows.
    """
    half, (height, width) = side_px // 2, depth_m.shape[2:]
    padded = pad(depth_m, (half, half, half, half), mode="replicate")
    column = [padded[:, :, y : y + height] for y in range(side_px)]
    for low, high in _sorting_network(side_px):
        lower, upper = column[low], column[high]
        column[low], column[high] = torch.minimum(lower, upper), torch.maximum(lower, upper)
    window = [level[..., x : x + width] for level in column for x in range(side_px)]
    comparators, middle = _median_network(side_px)
    for low, high, makes_low, makes_high in comparators:
        lower, upper = window[low], window[high]
        if makes_low:
            window[low] = torch.minimum(lower, upper)
        if makes_high:
            window[high] = torch.maximum(lower, upper)
    return window[middle]


@lru_cache
def _median_network(side_px: int) -> tuple[tuple[tuple[int, int, bool, bool], ...], int]:
    """Comparators that bring the median of a window with sorted columns to one position.

    Position `row * side_px + column`. Once the rows are sorted too (which leaves the columns
    sorted), the value at (row, column) is no smaller than (row + 1) * (column + 1) values, itself
    included, and no larger than as many counted from the other corner. That rules out as many
    values below the median as above it; the median of the others is sorted out among them.

    Returns:
        Comparators (low, high, is the minimum needed, is the maximum needed), and the position of
        the median.
    """
    side = range(side_px)
    middle = side_px * side_px // 2
    candidates = [
        row * side_px + column
        for row in side
        for column in side
        if (row + 1) * (column + 1) <= middle + 1
        and (side_px - row) * (side_px - column) <= middle + 1
    ]
    pairs = [
        (row * side_px + low, row * side_px + high)
        for row in side
        for low, high in _sorting_network(side_px)
    ]
    pairs += [
        (candidates[low], candidates[high]) for low, high in _sorting_network(len(candidates))
    ]
    median = candidates[len(candidates) // 2]
    # Backwards: drops results that neither a later comparator nor the median needs.
    needed, kept = {median}, []
    for low, high in reversed(pairs):
        if low in needed or high in needed:
            kept.append((low, high, low in needed, high in needed))
            needed |= {low, high}
    return tuple(reversed(kept)), median


def _sorting_network(count: int) -> Iterator[tuple[int, int]]:
    """Pairs (low, high) to compare and exchange: Batcher's merge exchange sort.

    Knuth, The Art of Computer Programming 3, section 5.2.2, Algorithm M.
    """
    largest = 1 << max(count - 1, 1).bit_length() - 1
    step = largest
    while step:
        stride, remainder, distance = largest, 0, step
        while True:
            for low in range(count - distance):
                if low & step == remainder:
                    yield low, low + distance
            if stride == step:
                break
            distance, stride, remainder = stride - step, stride // 2, step
        step //= 2

"""Number types and columns of raw point clouds, found from their values.

Without PyTorch, for checks that start at once.
"""

from typing import Any, Final

import numpy as np
from jaxtyping import Float, Float64

from sightline.geometry.echoes import is_echo
from sightline.geometry.mount import MAX_RANGE_M

_OTHER_LAYOUTS: Final = (
    *(("<f4", columns) for columns in (3, 5, 6, 7, 8, 12, 16)),
    *(("<f8", columns) for columns in (3, 4, 5, 6)),
    *(("<f2", columns) for columns in (3, 4, 5, 6)),
)
_WIDE_LAYOUTS: Final = (("<f4", 8), ("<f4", 12), ("<f4", 16), ("<f2", 4))
"""Layouts whose rows of 16 bytes may be plausible points, too."""
_ALTERNATING_SHARES: Final = (0.5, 0.99)
"""Largest share of odd values in points, and smallest in other columns."""
_MIN_ALTERNATING: Final = 100
"""Smallest number of rows with an echo, in points and other columns."""
_UNIT_TOLERANCE: Final = 1e-3
_SAMPLED_ROWS: Final = 500
_MIN_BYTES: Final = 320  # twenty points: fewer give too little evidence
_MIN_REACH_M: Final = 0.01  # numbers of another type are often tiny
_MIN_REACH_SHARE: Final = 0.1
_FINITE_SHARE: Final = 0.5  # share of rows with points in range
_MAX_UNLIKENESS_RATIO: Final = (
    0.8  # largest ratio of unlikeness to that of rows of four for another layout
)
_NOT_FINITE_VALUE: Final = 1e30  # replaces values that are not finite


def other_layout(content: bytes) -> tuple[np.dtype[Any], int] | None:
    """Find the number type and columns of a raw cloud that is not float32 x, y, z, intensity.

    A layout has to fit the length, give points within a LiDAR's range with non-negative
    intensities, and repeat: neighbouring points have similar numbers in the same column. If rows of
    16 bytes fulfil all this, they are preferred, and the result is None, unless only every second,
    third or fourth of them is a point.
    """
    narrow = np.frombuffer(content[: len(content) // 4 * 4], "<f4")
    layouts = _OTHER_LAYOUTS
    if len(content) % 16 == 0:
        if len(content) < _MIN_BYTES:
            return None
        if _is_plausible(narrow.reshape(-1, 4)):
            layouts = tuple(each for each in _WIDE_LAYOUTS if _may_fit_better(content, *each))
    found: list[tuple[float, str, int]] = []
    for kind, columns in layouts:
        row_bytes = int(kind[-1]) * columns
        if len(content) % row_bytes or len(content) < 2 * row_bytes:
            continue
        values = np.frombuffer(content, kind).astype("<f4" if kind == "<f2" else kind, copy=False)
        rows = values.reshape(-1, columns)
        if _is_plausible(rows) and _reach_share(rows) > _MIN_REACH_SHARE:
            found.append((_unlikeness(values, columns), kind, columns))
    if not found:
        return None
    limit = _MAX_UNLIKENESS_RATIO * _unlikeness(narrow, 4)
    found = [each for each in found if each[0] < limit]
    best = min((each[0] for each in found), default=0.0)
    return next(
        ((np.dtype(kind), columns) for score, kind, columns in found if score <= 1.1 * best), None
    )


def is_big_endian(content: bytes) -> bool:
    """Check if a raw cloud of float32 rows of four is plausible in big-endian order only.

    With fewer than twenty points the result is False, since there is too little evidence.
    """
    if len(content) % 16 or len(content) < _MIN_BYTES:
        return False
    little, big = (np.frombuffer(content, order).reshape(-1, 4) for order in ("<f4", ">f4"))
    is_cloud = _reach_share(big) > 0.5  # of swapped NaN 1e-41
    return is_cloud and not _is_plausible(little) and _is_plausible(big)


def has_columns(content: bytes, columns: int) -> bool:
    """Check if float32 rows of `columns` values (x, y, z, intensity first) are plausible points.

    With fewer than twenty points the result is False, since there is too little evidence.
    """
    row_bytes = 4 * columns
    if len(content) % row_bytes or len(content) < 20 * row_bytes:
        return False
    return _is_plausible(np.frombuffer(content, "<f4").reshape(-1, columns))


def _is_plausible(rows: Float[np.ndarray, "num_points columns"]) -> bool:
    """Check if rows can be points in metres, with any brightness."""
    in_order = rows[:, :3].min() >= -MAX_RANGE_M and rows[:, :3].max() <= MAX_RANGE_M
    if in_order and not (rows[:, 3:4] < 0).any() and np.isfinite(rows[:, 3:4]).all():
        return True  # most files; the rest takes five times as long
    reach_m = np.abs(rows[:, :3]).max(axis=1, initial=0)
    finite = np.isfinite(rows[:, :4]).all(axis=1)
    if finite.mean() < _FINITE_SHARE or (rows[finite, 3:4] < 0).any():
        return False
    return bool((reach_m[finite] <= MAX_RANGE_M).mean() > _FINITE_SHARE)


def _reach_share(rows: Float[np.ndarray, "num_points columns"]) -> float:
    """Share of rows with points that are not at the origin."""
    return float((np.abs(rows[:, :3]).max(axis=1) > _MIN_REACH_M).mean())


def _may_fit_better(content: bytes, kind: str, columns: int) -> bool:
    """Check a layout for a file whose rows of 16 bytes are plausible, by a sample of rows first."""
    if len(content) % (int(kind[-1]) * columns):
        return False
    rows = np.frombuffer(content, kind).reshape(-1, columns)
    fits = _is_plausible if kind == "<f2" else _alternates
    step = max(len(rows) // _SAMPLED_ROWS, 1)
    return fits(rows[::step].astype("<f4")) and fits(rows.astype("<f4", copy=False))


def _alternates(rows: Float[np.ndarray, "num_rows columns"]) -> bool:
    """Check if the first four columns are points, and four of the others cannot be.

    All their first or second numbers are whole, such as rings, or three of them have the length 1,
    as normals have.
    """
    points, *others = (rows[:, first : first + 4] for first in range(0, rows.shape[1], 4))
    most, least = _ALTERNATING_SHARES
    is_usual = _shares_of_odd_values(points) < most
    return any((is_usual & (_shares_of_odd_values(other) > least)).any() for other in others)


def _shares_of_odd_values(rows: Float[np.ndarray, "num_rows 4"]) -> Float64[np.ndarray, "3"]:
    """Shares of rows with a whole x, with a whole y, and with x, y, z of length 1.

    Rows without an echo are ignored. NaN for fewer than a hundred others, which are too little
    evidence, and for equal rows: rays without an echo, at a moved origin.
    """
    kept = rows[is_echo(rows)]
    if len(kept) < _MIN_ALTERNATING or (kept == kept[0]).all():
        return np.full(3, np.nan)
    lengths = np.linalg.norm(kept[:, :3].astype(np.float64), axis=1)
    is_whole = kept[:, :2] == np.rint(kept[:, :2])
    return np.array([*is_whole.mean(axis=0), (np.abs(lengths - 1) < _UNIT_TOLERANCE).mean()])


def _unlikeness(values: Float[np.ndarray, " count"], columns: int) -> float:
    """Mean of log(1 + difference) between numbers and the next row's."""
    level = np.where(np.isfinite(values), values, _NOT_FINITE_VALUE).astype(np.float64)
    steps = np.log1p(np.abs(level[columns:] - level[:-columns]))
    return float(steps.mean()) if len(steps) else _NOT_FINITE_VALUE

"""Scores by the distance of centres: as JSON, and as rows and columns of tables."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

from sightline.evaluation.centre_pairs import CENTRE_DISTANCES_M
from sightline.evaluation.object_tables import percentage

ERROR_DISTANCE_M: Final = 2.0
"""Distance of centres below which a found object counts for the errors."""
CENTRE_COLUMNS: Final = (
    "AP_centre",
    "AP_centre_2m",
    "translation_error_m",
    "scale_error",
    "orientation_error_rad",
)
"""Names of the scores in spreadsheets."""
CENTRE_INTERVAL: Final = ("AP_centre_low", "AP_centre_high")


@dataclass(frozen=True, kw_only=True, slots=True)
class CentreScores:
    """nuScenes' scores of one class and difficulty; see `sightline.evaluation.centre_distance`.

    The errors are means over the recall positions above 0.1 that are reached at 2 m; each position
    has the mean error of the objects found up to there. They are None if none is reached
    (nuScenes' program gives 1).
    """

    ap: float
    """Mean of `ap_at`, percent."""
    ap_at: tuple[float, ...]
    """AP for each of `CENTRE_DISTANCES_M`, percent."""
    low: float | None = None
    """2.5 % quantile of `ap` over resampled frames, percent; None without resamples, or of fewer
    than `MIN_FRAMES` frames."""
    high: float | None = None
    """97.5 % quantile of `ap`, percent; None in the same cases."""
    translation_error_m: float | None
    """Distance of the centres on the ground."""
    scale_error: float | None
    """One minus the IoU after aligning centres and axes, 0 to 1."""
    orientation_error_rad: float | None
    """Difference of the headings, 0 to pi."""

    @property
    def ap_2m(self) -> float:
        """AP for 2 m, percent."""
        return self.ap_at[CENTRE_DISTANCES_M.index(ERROR_DISTANCE_M)]

    def to_json(self) -> dict[str, Any]:
        """Convert the scores to the report file's content."""
        by_distance = zip(CENTRE_DISTANCES_M, self.ap_at, strict=True)
        return {
            "AP": self.ap,
            "AP_95": None if self.low is None else [self.low, self.high],
            "AP_by_distance": {f"{distance:g}": ap for distance, ap in by_distance},
            "translation_error_m": self.translation_error_m,
            "scale_error": self.scale_error,
            "orientation_error_rad": self.orientation_error_rad,
        }


def centre_rows(
    levels: Sequence[CentreScores | None], *, with_interval: bool
) -> list[tuple[str, list[str]]]:
    """List the rows of a table: names, and a cell for each difficulty.

    Args:
        levels: Scores of each difficulty; None if no object counts.
        with_interval: Whether to add the interval of AP.
    """
    cells = [list(centre_cells(each, with_interval=False)) for each in levels]
    names = ("AP 0.5-4 m", "AP 2 m", "translation, m", "scale, 1 - IoU", "heading, rad")
    rows = [
        (name, [percentage(value) for value in column])
        for name, column in zip(names, zip(*cells, strict=True), strict=True)
    ]
    if with_interval:
        rows.insert(1, ("95 % interval", [_interval(each) for each in levels]))
    return rows


def centre_cells(scores: CentreScores | None, *, with_interval: bool) -> Iterator[float | None]:
    """Yield the values of `CENTRE_COLUMNS`, then those of `CENTRE_INTERVAL` if requested."""
    if scores is None:
        yield from [None] * len(CENTRE_COLUMNS)
    else:
        yield from (scores.ap, scores.ap_2m, scores.translation_error_m)
        yield from (scores.scale_error, scores.orientation_error_rad)
    if with_interval:
        yield from (None, None) if scores is None else (scores.low, scores.high)


def _interval(scores: CentreScores | None) -> str:
    if scores is None or scores.low is None or scores.high is None:
        return "-"
    return f"{scores.low:.1f}-{scores.high:.1f}"

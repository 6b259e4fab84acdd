"""What corruptions cost, in the measures of the field, for scores and for errors alike.

Every measure flatters somebody, so they are told together:

* mPC, the mean performance under corruption: Michaelis et al. 2019, Eq. 1. Mean over the kinds of
  the mean over their severities.
* RR, the resilience rate: Kong et al. 2023 (Robo3D, metrics). What of the clean performance is
  left under a kind; mRR is its mean over the kinds.
* CE, the corruption error: Hendrycks and Dietterich 2019 (ImageNet-C, metric); for average
  precision as Kong et al. 2023. A kind's errors against a baseline's; mCE is its mean over the
  kinds.
* The worst case.
* The gap to the best healthy sensor alone: fusion must not be worse than that.

Departure: the papers measure where more is better. Of a figure that is an error itself (RMSE say,
`Figure.highest` None) mPC is the mean error, the worst case the largest, RR the clean error by the
mean corrupted one, and CE takes the errors as they are. So RR is 1 where nothing is lost, and CE
below 1 is better than the baseline, for every figure. Percent nowhere: RR and CE are ratios.
"""

import statistics
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from sightline.robustness.scoring import Figure

ByKind = Mapping[str, Sequence[float]]
"""One figure's scores by kind of corruption, one for each severity."""


class WorstCase(NamedTuple):
    """Where a method does worst."""

    case: str
    score: float


def mean_corrupted(scores: ByKind) -> float:
    """Mean over kinds of the mean over severities: mPC."""
    return statistics.fmean(statistics.fmean(levels) for levels in scores.values())


def resilience(levels: Sequence[float], clean: float, figure: Figure) -> float | None:
    """How much of the clean performance is left under a kind: RR; None where there was none.

    Above 1 where a corruption helps. Not bounded for small figures: read it beside the scores.
    """
    corrupted = statistics.fmean(levels)
    if figure.highest is None:
        return clean / corrupted if corrupted > 0 else None
    return corrupted / clean if clean > 0 else None


def corruption_error(
    levels: Sequence[float], baseline: Sequence[float], figure: Figure
) -> float | None:
    """A kind's errors by those of the baseline: CE; None where the baseline makes no error.

    Args:
        levels: The method's scores, one for each severity.
        baseline: The baseline's, of the same severities.
        figure: What they are scores of.
    """
    ours, theirs = (sum(figure.error(score) for score in each) for each in (levels, baseline))
    return ours / theirs if theirs > 0 else None


def mean_of_kinds(values: Mapping[str, float | None]) -> float | None:
    """Of RR or CE: mRR, mCE; None where it is not defined for one of the kinds."""
    known = [value for value in values.values() if value is not None]
    return statistics.fmean(known) if known and len(known) == len(values) else None


def worst_case(scores: Mapping[str, float], figure: Figure) -> WorstCase:
    """The case of the largest error, the first of several."""
    name = max(scores, key=lambda case: figure.error(scores[case]))
    return WorstCase(name, scores[name])


def healthy_gap(score: float, healthy: Sequence[float], figure: Figure) -> float | None:
    """By how much a score is better than the best sensor alone that is healthy; None without any.

    Negative where fusion is worse than leaving the broken sensor out.

    Args:
        score: Of the method, in a case.
        healthy: Clean scores of methods that look at one sensor each, which the case leaves alone.
        figure: What they are scores of.
    """
    leads = [figure.lead(score, alone) for alone in healthy]
    return min(leads) if leads else None

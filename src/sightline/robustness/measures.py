"""Standard measures of the loss caused by corruptions, for scores and for errors.

Every measure favours some methods, so they are reported together:

* mPC, the mean performance under corruption: Michaelis et al. 2019, Eq. 1. Mean over the kinds of
  the mean over their severities.
* RR, the resilience rate: Kong et al. 2023 (Robo3D, metrics). The remaining share of the clean
performance under a kind; mRR is its mean over the kinds.
* CE, the corruption error: Hendrycks and Dietterich 2019 (ImageNet-C, metric); for average
  precision as Kong et al. 2023. A kind's errors relative to a baseline's; mCE is its mean over the
  kinds.
* The worst case.
* The gap to the best healthy sensor alone: fusion must not be worse than that.

Departure: in the papers a higher score is better. For a metric that is an error itself (e.g. RMSE,
`BenchMetric.highest` None), mPC is the mean error, the worst case the largest, RR the clean error
over the mean corrupted one, and CE uses the errors directly. So RR is 1 without loss, and CE below
1 is better than the baseline, for every metric. RR and CE are ratios, not percentages.
"""

import statistics
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from sightline.robustness.scoring import BenchMetric

ByKind = Mapping[str, Sequence[float]]
"""One metric's scores by kind of corruption, one for each severity."""


class WorstCase(NamedTuple):
    """Worst case of a method."""

    case: str
    score: float


def mean_corrupted(scores: ByKind) -> float:
    """Compute the mean over kinds of the mean over severities: mPC."""
    return statistics.fmean(statistics.fmean(levels) for levels in scores.values())


def resilience(levels: Sequence[float], clean: float, metric: BenchMetric) -> float | None:
    """Compute the remaining share of the clean performance under a kind: RR; None without any.

    It is above 1 if a corruption helps. It is not bounded for small clean scores: compare it with
    the scores.
    """
    corrupted = statistics.fmean(levels)
    if metric.highest is None:
        return clean / corrupted if corrupted > 0 else None
    return corrupted / clean if clean > 0 else None


def corruption_error(
    levels: Sequence[float], baseline: Sequence[float], metric: BenchMetric
) -> float | None:
    """Compute a kind's errors over the baseline's: CE; None if the baseline has no error.

    Args:
        levels: The method's scores, one for each severity.
        baseline: The baseline's scores, of the same severities.
        metric: Metric of the scores.
    """
    own, other = (sum(metric.error(score) for score in each) for each in (levels, baseline))
    return own / other if other > 0 else None


def mean_of_kinds(values: Mapping[str, float | None]) -> float | None:
    """Average RR or CE over kinds: mRR, mCE; None if one is undefined."""
    known = [value for value in values.values() if value is not None]
    return statistics.fmean(known) if known and len(known) == len(values) else None


def worst_case(scores: Mapping[str, float], metric: BenchMetric) -> WorstCase:
    """Find the case of the largest error, the first of several."""
    name = max(scores, key=lambda case: metric.error(scores[case]))
    return WorstCase(name, scores[name])


def healthy_gap(score: float, healthy: Sequence[float], metric: BenchMetric) -> float | None:
    """Compute the lead of a score over the best healthy sensor alone; None without any.

    It is negative if fusion is worse than omitting the faulty sensor.

    Args:
        score: Score of the method in a case.
        healthy: Clean scores of single-sensor methods whose sensor is not affected by the case.
        metric: Metric of the scores.
    """
    leads = [metric.lead(score, each) for each in healthy]
    return min(leads) if leads else None

"""All measures of a run, by metric."""

import statistics
from collections.abc import Mapping
from dataclasses import dataclass

from sightline.corruptions.suites import CLEAN
from sightline.robustness.measures import (
    WorstCase,
    corruption_error,
    healthy_gap,
    mean_corrupted,
    mean_of_kinds,
    resilience,
    worst_case,
)
from sightline.robustness.record import Record
from sightline.robustness.scoring import BenchMetric
from sightline.structures.sample import Sensor


@dataclass(frozen=True, kw_only=True, slots=True)
class KindMeasures:
    """Loss caused by a kind of corruption."""

    mean: float
    """Mean over its severities."""
    rr: float | None
    ce: float | None
    """Corruption error; None without a baseline, or if the baseline has no error."""
    gap: float | None
    """Smallest gap over its severities; None without a healthy sensor's record."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Measures:
    """Loss caused by corruptions, by one metric."""

    clean: float
    mpc: float
    mrr: float | None
    mce: float | None
    worst: WorstCase
    gap: WorstCase | None
    """Smallest lead over the best healthy sensor, with its case; None without a healthy sensor."""
    gaps: Mapping[str, float | None]
    """Gaps by case."""
    kinds: Mapping[str, KindMeasures]

    def to_json(self) -> dict[str, object]:
        """Convert to the content of a run's file."""
        return {
            "clean": self.clean,
            "mPC": self.mpc,
            "mRR": self.mrr,
            "mCE": self.mce,
            "worst": self.worst._asdict(),
            "gap": None if self.gap is None else self.gap._asdict(),
            "gaps": dict(self.gaps),
            "kinds": {
                kind: {"mean": each.mean, "RR": each.rr, "CE": each.ce, "gap": each.gap}
                for kind, each in self.kinds.items()
            },
        }


def measure(
    record: Record,
    metric: BenchMetric,
    baseline: Record | None = None,
    healthy: Mapping[Sensor, Record] | None = None,
) -> Measures | None:
    """Compute the measures by one metric; None without scores or corrupted cases.

    Args:
        record: Record of the method.
        metric: One of its metrics.
        baseline: Baseline for CE, with all cases of the record.
        healthy: Single-sensor methods, by their sensor. In a case that does not affect the sensor,
            its method keeps the clean score.
    """
    clean, table = record.score(CLEAN, metric), record.by_kind(metric)
    if clean is None or not table:
        return None
    baseline_scores = None if baseline is None else baseline.by_kind(metric, record.kinds)
    gaps = _gaps(record, metric, healthy or {})
    known = {case: gap for case, gap in gaps.items() if gap is not None}
    smallest = min(known, key=known.__getitem__) if known else None
    kinds = {
        kind: KindMeasures(
            mean=statistics.fmean(levels),
            rr=resilience(levels, clean, metric),
            ce=None
            if baseline_scores is None
            else corruption_error(levels, baseline_scores[kind], metric),
            gap=min((known[case] for case in record.kinds[kind] if case in known), default=None),
        )
        for kind, levels in table.items()
    }
    scores = {
        case: score
        for kind, levels in table.items()
        for case, score in zip(record.kinds[kind], levels, strict=True)
    }
    return Measures(
        clean=clean,
        mpc=mean_corrupted(table),
        mrr=mean_of_kinds({kind: each.rr for kind, each in kinds.items()}),
        mce=mean_of_kinds({kind: each.ce for kind, each in kinds.items()}),
        worst=worst_case(scores, metric),
        gap=None if smallest is None else WorstCase(smallest, known[smallest]),
        gaps=gaps,
        kinds=kinds,
    )


def _gaps(
    record: Record, metric: BenchMetric, healthy: Mapping[Sensor, Record]
) -> dict[str, float | None]:
    """Compute the lead over the best healthy sensor alone in each case, sound sensors included."""
    clean_scores = {sensor: each.score(CLEAN, metric) for sensor, each in healthy.items()}
    gaps: dict[str, float | None] = {}
    for name, case in record.cases.items():
        score = record.score(name, metric)
        healthy_scores = [
            clean
            for sensor, clean in clean_scores.items()
            if clean is not None and sensor not in case.sensors
        ]
        gaps[name] = None if score is None else healthy_gap(score, healthy_scores, metric)
    return gaps

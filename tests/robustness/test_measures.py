"""Measures, compared with loops over a plain table."""

import math

from hypothesis import given
from hypothesis import strategies as st

from sightline.robustness.measured import measure
from sightline.robustness.measures import (
    corruption_error,
    healthy_gap,
    mean_corrupted,
    mean_of_kinds,
    resilience,
    worst_case,
)
from sightline.robustness.scoring import BenchMetric
from tests.reference import robustness as reference
from tests.robustness.runs import AP, RMSE, record_of

ap = st.sampled_from([0.0, 12.5, 50.0, 50.5, 99.0, 100.0])  # ties, nothing and all are common
rmse = st.sampled_from([0.0, 0.5, 800.0, 950.0, 20000.0])


@st.composite
def tables(draw):
    """Draw a metric, a clean score, and two tables of kinds by severities."""
    metric = draw(st.sampled_from([AP, RMSE]))
    scores = ap if metric is AP else rmse
    severities = draw(
        st.dictionaries(
            st.sampled_from(["fog", "rain", "noise", "beams"]),
            st.integers(1, 5),
            min_size=1,
        )
    )
    first, second = (
        {
            kind: {level: draw(scores) for level in range(1, count + 1)}
            for kind, count in severities.items()
        }
        for _ in range(2)
    )
    return metric, draw(scores), first, second


def same(actual, expected):
    """Whether two numbers are equal up to the order of sums, or both undefined."""
    if actual is None or expected is None:
        return actual is None and expected is None
    return math.isclose(actual, expected, rel_tol=1e-12, abs_tol=1e-9)


@given(tables())
def test_the_measures_are_what_loops_say_for_scores_and_for_errors(drawn):
    metric, clean, table, baseline = drawn
    levels = {kind: list(row.values()) for kind, row in table.items()}
    assert same(mean_corrupted(levels), reference.mpc(table))
    rates, errors = {}, {}
    for kind, row in table.items():
        rates[kind] = reference.rr(row, clean, metric.highest)
        errors[kind] = reference.ce(row, baseline[kind], metric.highest)
        theirs = list(baseline[kind].values())
        assert same(resilience(levels[kind], clean, metric), rates[kind])
        assert same(corruption_error(levels[kind], theirs, metric), errors[kind])
    assert same(mean_of_kinds(rates), reference.mean_or_none(rates.values()))
    assert same(mean_of_kinds(errors), reference.mean_or_none(errors.values()))
    by_case = {f"{kind}-{level}": s for kind, row in table.items() for level, s in row.items()}
    kind, level, score = reference.worst(table, metric.highest)
    assert worst_case(by_case, metric) == (f"{kind}-{level}", score)


@given(
    metric=st.sampled_from([AP, RMSE]),
    score=ap,
    healthy=st.lists(ap, max_size=2),
)
def test_the_gap_is_to_the_best_healthy_sensor(metric, score, healthy):
    gap = healthy_gap(score, healthy, metric)
    assert same(gap, reference.gap(score, healthy, metric.highest))


@given(tables())
def test_a_whole_run_is_measured_as_its_parts_are(drawn):
    metric, clean, table, other = drawn
    record, baseline = (record_of(metric, clean, each) for each in (table, other))
    measures = measure(record, metric, baseline)
    assert same(measures.mpc, reference.mpc(table))
    for kind, each in measures.kinds.items():
        assert same(each.rr, reference.rr(table[kind], clean, metric.highest))
        assert same(each.ce, reference.ce(table[kind], other[kind], metric.highest))
        assert each.gap is None
    assert measures.gap is None


@given(tables())
def test_a_method_held_against_itself_makes_as_many_errors(drawn):
    metric, clean, table, _ = drawn
    record = record_of(metric, clean, table)
    for each in measure(record, metric, record).kinds.values():
        assert each.ce is None or math.isclose(each.ce, 1)


def test_nothing_lost_is_an_rr_of_1_and_half_as_many_errors_a_ce_of_a_half_for_every_figure():
    for metric, clean, halved in ((AP, 60.0, 80.0), (RMSE, 900.0, 450.0)):
        assert resilience([clean, clean], clean, metric) == 1
        assert math.isclose(corruption_error([halved], [clean], metric), 0.5)
    assert resilience([30.0], 60.0, AP) == resilience([1800.0], 900.0, RMSE) == 0.5


def test_only_a_sensor_that_a_case_leaves_alone_is_healthy_in_it():
    table = {"camera_fog": {1: 40.0}, "lidar_fog": {1: 70.0}, "sun": {1: 10.0}}
    sensors = {"camera_fog": ("camera",), "lidar_fog": ("lidar",), "sun": ("camera", "lidar")}
    record = record_of(AP, 80.0, table, sensors=sensors)
    alone = {"camera": record_of(AP, 60.0, {}), "lidar": record_of(AP, 50.0, {})}
    measures = measure(record, AP, None, alone)
    assert measures.gaps == {
        "clean": 20.0,
        "camera_fog-1": -10.0,  # the LiDAR alone would have had 50
        "lidar_fog-1": 10.0,
        "sun-1": None,
    }
    assert measures.gap == ("camera_fog-1", -10.0)


def test_where_there_is_nothing_to_score_nothing_is_measured():
    record = record_of(AP, None, {"fog": {1: None}})
    assert measure(record, AP) is None
    assert measure(record_of(AP, 50.0, {}), AP) is None


def test_a_figure_tells_errors_and_leads_in_its_own_direction():
    assert AP.error(70.0) == 30.0
    assert RMSE.error(70.0) == 70.0
    assert AP.lead(70.0, 60.0) == RMSE.lead(60.0, 70.0) == 10.0
    assert BenchMetric(name="x", title="x", unit="m").highest is None

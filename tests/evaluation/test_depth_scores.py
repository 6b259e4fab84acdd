import math
from dataclasses import asdict, fields

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from sightline.evaluation.depth_scores import (
    DepthScores,
    fill_gaps,
    mean_scores,
    score_depth,
    score_predicted_pixels,
)
from tests.reference import depth_metrics as reference

# as in PNGs: steps of 1/256 m, 0 = none
depths = st.one_of(st.just(0), st.integers(1, 65535)).map(lambda steps: steps / 256)
sizes = st.tuples(st.integers(1, 6), st.integers(1, 7))


@st.composite
def maps(draw, number):
    size = draw(sizes)
    return [draw(hnp.arrays(np.float32, size, elements=depths)) for _ in range(number)]


def close(scores, expected):
    got = asdict(scores)
    assert list(got) == list(expected) == list(reference.NAMES)
    for name, value in expected.items():
        # silog of errors that are all alike is 0 up to rounding
        assert got[name] == pytest.approx(value, rel=1e-9, abs=1e-9, nan_ok=True), name


@given(maps(2))
def test_scores_agree_with_a_calculation_pixel_by_pixel(pair):
    prediction, truth = pair
    assume((truth > 0).any())
    lists = prediction.astype(float).tolist(), truth.astype(float).tolist()
    close(score_depth(prediction, truth), reference.scores(*lists))
    masked = score_predicted_pixels(prediction, truth)
    expected = reference.scores(*lists, predicted_pixels_only=True)
    if expected is None:
        assert masked is None
    else:
        close(masked, expected)


@given(maps(1))
def test_the_fill_agrees_with_a_calculation_pixel_by_pixel(one):
    (depth,) = one
    assert fill_gaps(depth).tolist() == reference.fill_gaps(depth.astype(float).tolist())


@given(maps(1))
def test_filling_twice_changes_nothing_and_values_that_are_there_stay(one):
    (depth,) = one
    filled = fill_gaps(depth)
    assert np.array_equal(filled[depth > 0], depth[depth > 0])
    assert np.array_equal(fill_gaps(filled), filled)


@given(maps(1))
def test_the_truth_itself_scores_no_error(one):
    (depth,) = one
    assume((depth > 0).any())
    scores = asdict(score_depth(depth, depth))
    assert scores.pop("coverage") == 1
    assert set(scores.values()) == {0.0}


@given(maps(2), st.integers(0, 2**32 - 1))
def test_what_a_prediction_says_beside_the_ground_truth_does_not_count(pair, seed):
    prediction, truth = (np.where(depth > 0, depth, np.float32(1)) for depth in pair)
    truth[0, 1:] = 0
    other = np.random.default_rng(seed).uniform(1, 80, prediction.shape).astype(np.float32)
    elsewhere = np.where(truth > 0, prediction, other)
    assert score_depth(elsewhere, truth) == score_depth(prediction, truth)


def row(*depths_m):
    return np.array([depths_m], dtype=np.float32)


def test_a_gap_within_a_row_takes_the_nearer_of_its_two_ends():
    assert fill_gaps(row(5, 0, 0, 3, 0, 9)).tolist() == [[5, 3, 3, 3, 3, 9]]


def test_the_ends_of_a_row_take_the_outermost_depths():
    assert fill_gaps(row(0, 0, 5, 3, 0)).tolist() == [[5, 5, 5, 3, 3]]


def test_rows_above_the_first_and_below_the_last_with_depths_become_copies_of_them():
    depth = np.array([[0, 0], [0, 2], [7, 0], [0, 0], [0, 0]], dtype=np.float32)
    assert fill_gaps(depth).tolist() == [[2, 2], [2, 2], [7, 7], [7, 7], [7, 7]]


def test_an_empty_row_between_others_stays_at_minus_one_metre():
    depth = np.array([[4, 0], [0, 0], [6, 0]], dtype=np.float32)
    assert fill_gaps(depth).tolist() == [[4, 4], [-1, -1], [6, 6]]


def test_a_map_without_any_depth_stays_at_minus_one_metre():
    assert fill_gaps(np.zeros((2, 2), np.float32)).tolist() == [[-1, -1], [-1, -1]]


def test_an_unfilled_pixel_counts_as_minus_one_metre_and_leaves_silog_undefined():
    prediction = np.array([[4], [0], [4]], dtype=np.float32)
    truth = np.array([[0], [4], [0]], dtype=np.float32)
    scores = score_depth(prediction, truth)
    assert scores.mae_mm == 5000
    assert scores.imae_per_km == 1250  # 1/4 + 1/1 per metre
    assert math.isnan(scores.silog)
    assert scores.to_json()["silog"] is None
    assert scores.coverage == 0
    assert score_predicted_pixels(prediction, truth) is None


def test_sq_rel_divides_by_the_squared_depth_and_not_by_the_depth():
    scores = score_depth(row(12), row(10))
    assert scores.sq_rel == pytest.approx(0.04)
    assert scores.abs_rel == pytest.approx(0.2)


def test_silog_is_the_population_standard_deviation_times_100():
    scores = score_depth(row(10, 10 * math.e), row(10, 10))
    assert scores.silog == pytest.approx(50, rel=1e-6)


def test_silog_does_not_see_a_common_scale():
    assert score_depth(row(2, 4, 8), row(1, 2, 4)).silog == pytest.approx(0, abs=1e-12)


def test_silog_keeps_its_digits_where_all_errors_are_nearly_alike():
    # by mean square less squared mean, all digits of a spread of 1e-9 are lost
    truth = np.array([[80.0, 80.0]])
    prediction = np.array([[40.0, 40.0 * (1 + 1e-9)]])
    assert score_depth(prediction, truth).silog == pytest.approx(100 * 0.5e-9, rel=1e-5)


def test_inverse_errors_are_per_kilometre():
    assert score_depth(row(10), row(5)).imae_per_km == pytest.approx(100)


def test_predicted_pixels_only_leaves_out_what_the_fill_would_guess():
    prediction, truth = row(10, 0, 30), row(10, 20, 30)
    assert score_depth(prediction, truth).mae_mm == pytest.approx(10_000 / 3)
    masked = score_predicted_pixels(prediction, truth)
    assert masked.mae_mm == 0
    assert masked.coverage == score_depth(prediction, truth).coverage == pytest.approx(2 / 3)


def test_float64_maps_are_not_rounded_to_float32():
    scores = score_depth(np.array([[10.000000001]]), np.array([[10.0]]))
    assert scores.mae_mm == pytest.approx(1e-6, rel=1e-5)


def test_a_mean_is_undefined_where_one_image_is_or_there_is_none():
    defined = score_depth(row(1), row(2))
    values = asdict(defined) | {"silog": math.nan}
    mean = mean_scores([defined, DepthScores(**values)])
    assert math.isnan(mean.silog)
    assert mean.mae_mm == 1000
    nothing = mean_scores([])
    assert all(math.isnan(getattr(nothing, field.name)) for field in fields(nothing))


@pytest.mark.parametrize(
    ("prediction", "truth", "message"),
    [
        (
            row(1, 2),
            row(1),
            r"the prediction is 1x2 but the ground truth is 1x1 \(height x width\)",
        ),
        (row(1), row(0), "the ground truth holds no depth at all"),
        (row(np.nan), row(1), "the prediction holds depths that are negative or not finite"),
        (row(1), row(np.inf), "the ground truth holds depths that are negative or not finite"),
        (row(-1), row(1), "use 0 for no value"),
    ],
)
@pytest.mark.parametrize("score", [score_depth, score_predicted_pixels])
def test_maps_that_cannot_be_scored_are_refused(score, prediction, truth, message):
    with pytest.raises(ValueError, match=message):
        score(prediction, truth)

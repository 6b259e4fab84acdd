import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import expit

from sightline.evaluation.calibration_errors import find_reliability
from sightline.evaluation.calibrators import CALIBRATORS, fit_calibrator, logistic_loss
from tests.reference import calibration as reference

score = st.sampled_from([0.0, 0.04, 0.1, 0.25, 0.5, 0.6, 0.99, 1.0]) | st.floats(0, 1)
target = st.sampled_from([0.0, 0.0, 0.7, 0.85, 1.0])
outcomes = st.lists(st.tuples(score, target), min_size=1, max_size=25).map(
    lambda pairs: (np.array([p[0] for p in pairs]), np.array([p[1] for p in pairs]))
)


@given(outcomes=outcomes, num_bins=st.sampled_from([1, 3, 10, 25]))
def test_the_error_is_the_mean_distance_of_the_bins_counted_by_hand(outcomes, num_bins):
    scores, targets = outcomes
    # what a bin holds hangs on rounding at its edges: 0.1 * 10 is 1, 0.3 * 10 is not 3
    found = find_reliability(scores, targets, num_bins)
    assert found.error == pytest.approx(reference.expected_error(scores, targets, num_bins))
    assert found.counts.sum() == len(scores)


def test_without_detections_there_is_no_error():
    assert find_reliability(np.zeros(0), np.zeros(0), 10).error is None


@given(targets=st.lists(target, min_size=1, max_size=12))
def test_isotonic_values_are_the_largest_of_the_least_means(targets):
    scores = np.linspace(0.1, 0.9, len(targets))
    calibrated = fit_calibrator("isotonic", scores, np.array(targets))(scores)
    assert calibrated == pytest.approx(np.array(reference.isotonic(targets)), abs=1e-9)


@pytest.mark.parametrize("name", CALIBRATORS)
@given(outcomes=outcomes)
def test_calibrated_scores_are_probabilities_in_the_same_order(name, outcomes):
    scores, targets = outcomes
    grid = np.sort(np.concatenate((scores, np.linspace(0, 1, 20))))
    calibrated = fit_calibrator(name, scores, targets)(grid)
    assert ((calibrated >= 0) & (calibrated <= 1)).all()
    assert (np.diff(calibrated) >= 0).all()


@given(outcomes=outcomes, slope=st.floats(0, 8), intercept=st.floats(-5, 5))
def test_no_other_slope_and_intercept_fit_better(outcomes, slope, intercept):
    scores, targets = outcomes
    logits = np.log(np.clip(scores, 1e-6, 1 - 1e-6) / (1 - np.clip(scores, 1e-6, 1 - 1e-6)))
    platt = fit_calibrator("platt", scores, targets)
    temperature = fit_calibrator("temperature", scores, targets)
    best = logistic_loss(platt.slope * logits + platt.intercept, targets)
    assert best <= logistic_loss(slope * logits + intercept, targets) + 1e-6
    assert temperature.intercept == 0
    best = logistic_loss(temperature.slope * logits, targets)
    assert best <= logistic_loss(slope * logits, targets) + 1e-6


def test_the_distortion_that_scores_were_given_is_found_again():
    rng = np.random.default_rng(3)
    logits = rng.normal(0, 2, 40_000)
    targets = (rng.random(40_000) < expit(logits)).astype(np.float64)
    overconfident = expit(2.5 * logits)
    temperature = fit_calibrator("temperature", overconfident, targets)
    assert temperature.slope == pytest.approx(1 / 2.5, rel=0.05)
    platt = fit_calibrator("platt", expit(2.5 * logits - 1), targets)
    assert platt.slope == pytest.approx(1 / 2.5, rel=0.05)
    assert platt.intercept == pytest.approx(1 / 2.5, abs=0.05)
    for name in CALIBRATORS:
        before = find_reliability(overconfident, targets, 25).error
        calibrated = fit_calibrator(name, overconfident, targets)(overconfident)
        assert find_reliability(calibrated, targets, 25).error < 0.015 < 0.1 < before


def test_nothing_cannot_be_fitted_on():
    with pytest.raises(ValueError, match="no detection that counts"):
        fit_calibrator("platt", np.zeros(0), np.zeros(0))

"""Thresholds of corrections: equal to a slow reference, continuous, and non-finite values stay."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from sightline.depth_completion.config import SignedThreshold, by_direction
from sightline.depth_completion.corrections import (
    CorrectionThresholds,
    correction_thresholds,
    drop_small_corrections,
)
from tests.reference.corrections import counted


def constant_thresholds(threshold, shape):
    return CorrectionThresholds(*np.full((2, *shape), threshold, np.float32))


DIRECTIONS = st.sampled_from(((0.0, 0.0), (0.05, 0.3), (0.3, 0.02), (0.0, 0.6)))


@given(
    seed=st.integers(0, 10**6),
    height=st.integers(1, 80),
    width=st.integers(1, 20),
    share=st.sampled_from((0.0, 0.01, 0.1)),
    default=st.sampled_from((0.0, 0.05, 0.3)),
    above=DIRECTIONS,
    beside=DIRECTIONS,
)
def test_they_are_equal_to_the_slow_way(seed, height, width, share, default, above, beside):
    rng = np.random.default_rng(seed)
    is_measured = rng.random((height, width)) < share
    is_measured[: height // 2] = False
    filled_m = rng.uniform(1, 80, (height, width)).astype(np.float32)
    depth_m = (filled_m * np.exp(rng.normal(0, 0.3, (height, width)))).astype(np.float32)
    before = depth_m.copy()
    above, beside = (SignedThreshold(nearer=each[0], farther=each[1]) for each in (above, beside))
    thresholds = correction_thresholds(is_measured, default=default, above=above, beside=beside)
    corrected_m = drop_small_corrections(depth_m, filled_m, thresholds)
    expected_m = counted(depth_m, filled_m, is_measured, default, above, beside)
    np.testing.assert_allclose(corrected_m, expected_m, rtol=1e-4)
    np.testing.assert_array_equal(depth_m, before)


def test_the_threshold_rises_above_the_highest_measurement_of_the_columns_around():
    is_measured = np.zeros((100, 30), bool)
    is_measured[60, 10] = True
    nearer, farther = correction_thresholds(
        is_measured,
        default=0.05,
        above=SignedThreshold(nearer=0.25, farther=0.45),
        beside=by_direction(None, default=0.05),
    )
    np.testing.assert_allclose(nearer[40:, 10], 0.05)
    np.testing.assert_allclose(nearer[:31, 17], 0.25)
    assert np.isclose(nearer[35, 3], 0.15)
    assert np.isclose(nearer[76, 18], 0.05 + 0.2 * 2 / 5)  # nothing measured: above its foot
    np.testing.assert_allclose(farther - 0.05, 2 * (nearer - 0.05), atol=1e-6)


def test_beside_a_measurement_each_direction_has_a_threshold_of_its_own():
    is_measured = np.zeros((9, 9), bool)
    is_measured[4, 4] = True
    nearer, farther = correction_thresholds(
        is_measured,
        default=0.05,
        above=by_direction(None, default=0.05),
        beside=SignedThreshold(nearer=0.15, farther=0.45),
    )
    np.testing.assert_allclose(nearer[4, 3:6], 0.15)
    np.testing.assert_allclose(farther[3:6, 4], 0.45)
    np.testing.assert_allclose((nearer[4, 7], farther[2, 2], farther[4, 1]), 0.05)
    assert 0.05 < nearer[3, 3] < 0.15
    assert 0.05 < farther[2, 4] < farther[3, 3] < 0.45
    depth_m = np.full((9, 9), 20, np.float32)
    for factor, beside_m in ((np.exp(0.3), 20), (np.exp(-0.3), 20 * np.exp(-0.3))):
        thresholds = CorrectionThresholds(nearer, farther)
        corrected_m = drop_small_corrections(depth_m * np.float32(factor), depth_m, thresholds)
        np.testing.assert_allclose((corrected_m[4, 4], corrected_m[4, 8]), (beside_m, 20 * factor))


def test_corrections_grow_without_a_step():
    factors = np.exp(np.linspace(-0.4, 0.4, 4001))[None].astype(np.float32)
    filled_m = np.full_like(factors, 20)
    corrected_m = drop_small_corrections(
        factors * filled_m, filled_m, constant_thresholds(0.1, factors.shape)
    )
    assert np.abs(np.diff(corrected_m)).max() < 3.2 * np.abs(np.diff(factors * filled_m)).max()
    assert (corrected_m == 20).sum() > 900
    np.testing.assert_allclose(corrected_m[:, :1000], (factors * filled_m)[:, :1000], rtol=1e-5)


def test_what_is_no_depth_stays_as_the_network_gave_it():
    depth_m = np.array([[np.nan, np.inf, -np.inf, 0, -3, 5]], np.float32)
    filled_m = np.array([[4, 4, 4, 4, 4, 0]], np.float32)
    corrected_m = drop_small_corrections(
        depth_m, filled_m, constant_thresholds(0.1, filled_m.shape)
    )
    np.testing.assert_array_equal(corrected_m, depth_m)

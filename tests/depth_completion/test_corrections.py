"""Corrections that count: equal to the slow way, no steps, and nothing lost of what is no depth."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from sightline.depth_completion.corrections import drop_small_corrections, least_corrections
from tests.reference.corrections import counted


@given(
    seed=st.integers(0, 10**6),
    height=st.integers(1, 80),
    width=st.integers(1, 20),
    share=st.sampled_from((0.0, 0.01, 0.1)),
    least=st.sampled_from((0.0, 0.05, 0.3)),
    least_above=st.sampled_from((0.0, 0.05, 0.3)),
)
def test_they_are_equal_to_the_slow_way(seed, height, width, share, least, least_above):
    rng = np.random.default_rng(seed)
    is_measured = rng.random((height, width)) < share
    is_measured[: height // 2] = False
    filled_m = rng.uniform(1, 80, (height, width)).astype(np.float32)
    depth_m = (filled_m * np.exp(rng.normal(0, 0.3, (height, width)))).astype(np.float32)
    before = depth_m.copy()
    found_m = drop_small_corrections(
        depth_m, filled_m, least_corrections(is_measured, least=least, least_above=least_above)
    )
    expected_m = counted(depth_m, filled_m, is_measured, least, least_above)
    np.testing.assert_allclose(found_m, expected_m, rtol=1e-4)
    np.testing.assert_array_equal(depth_m, before)


def test_the_threshold_rises_above_the_highest_measurement_of_the_columns_around():
    is_measured = np.zeros((100, 30), bool)
    is_measured[60, 10] = True
    threshold = least_corrections(is_measured, least=0.05, least_above=0.2)
    np.testing.assert_allclose(threshold[40:, 10], 0.05)
    np.testing.assert_allclose(threshold[:11, 17], 0.2)
    assert np.isclose(threshold[25, 3], 0.125)
    assert np.isclose(threshold[60, 18], 0.05 + 0.15 * 2 / 3)  # nothing measured: above its foot


def test_corrections_grow_without_a_step():
    factors = np.exp(np.linspace(-0.4, 0.4, 4001))[None].astype(np.float32)
    filled_m = np.full_like(factors, 20)
    found_m = drop_small_corrections(
        factors * filled_m, filled_m, np.full_like(factors, 0.1, dtype=np.float32)
    )
    assert np.abs(np.diff(found_m)).max() < 3.2 * np.abs(np.diff(factors * filled_m)).max()
    assert (found_m == 20).sum() > 900
    np.testing.assert_allclose(found_m[:, :1000], (factors * filled_m)[:, :1000], rtol=1e-5)


def test_what_is_no_depth_stays_as_the_network_gave_it():
    depth_m = np.array([[np.nan, np.inf, -np.inf, 0, -3, 5]], np.float32)
    filled_m = np.array([[4, 4, 4, 4, 4, 0]], np.float32)
    found_m = drop_small_corrections(depth_m, filled_m, np.full_like(filled_m, 0.1))
    np.testing.assert_array_equal(found_m, depth_m)

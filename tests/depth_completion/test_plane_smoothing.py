"""Noise removal on planes: equal to a slow reference, edges and holes stay."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sightline.depth_completion.config import PlaneSmoothing
from sightline.depth_completion.plane_smoothing import smooth_planes
from tests.reference.plane_smoothing import smoothed

NOISE_M = 0.02


def ground(height=40, width=60):
    """Depth map of the road: a plane, from 41 m at the top to 10 m."""
    rows = np.arange(height, dtype=np.float64)[:, None]
    return np.broadcast_to(1 / (0.024 + rows * 0.076 / (height - 1)), (height, width)).astype(
        np.float32
    )


def noisy(depth_m, seed=0):
    noise = np.random.default_rng(seed).normal(0, NOISE_M, depth_m.shape)
    return (depth_m + noise).astype(np.float32)


@given(
    seed=st.integers(0, 10**6),
    height=st.integers(1, 7),
    width=st.integers(1, 7),
    windows_px=st.lists(st.integers(1, 9), min_size=1, max_size=2),
    noise_m=st.sampled_from((0.0, 0.02, 1.0)),
)
def test_it_is_equal_to_the_slow_way(seed, height, width, windows_px, noise_m):
    rng = np.random.default_rng(seed)
    depth_m = rng.choice((5.0, 20.0), (height, width)) + rng.normal(0, 0.1, (height, width))
    depth_m = np.where(rng.random((height, width)) < 0.1, 0, depth_m).astype(np.float32)
    before = depth_m.copy()
    smooth_m = smooth_planes(depth_m, windows_px=windows_px, noise_m=noise_m)
    np.testing.assert_allclose(smooth_m, smoothed(depth_m, windows_px, noise_m), rtol=1e-4)
    np.testing.assert_array_equal(depth_m, before)


def test_a_plane_stays_and_loses_most_of_its_noise():
    plane_m = ground()
    smooth_m = smooth_planes(plane_m, windows_px=(12, 24), noise_m=NOISE_M)
    np.testing.assert_allclose(smooth_m, plane_m, rtol=1e-5)
    residual_m = smooth_planes(noisy(plane_m), windows_px=(12, 24), noise_m=NOISE_M) - plane_m
    assert np.abs(residual_m).mean() < 0.4 * np.abs(noisy(plane_m) - plane_m).mean()


def test_an_edge_stays_where_it_is():
    depth_m = ground().copy()
    depth_m[10:35, 20:32] = 8  # a person before the road
    smooth_m = smooth_planes(noisy(depth_m), windows_px=(12, 24), noise_m=NOISE_M)
    assert np.abs(smooth_m - depth_m).max() < 6 * NOISE_M


def test_what_has_no_depth_gets_none_and_spoils_nothing():
    depth_m = ground().copy()
    depth_m[5, 7] = 0
    smooth_m = smooth_planes(depth_m, windows_px=(3,), noise_m=NOISE_M)
    assert smooth_m[5, 7] == 0
    np.testing.assert_allclose(np.delete(smooth_m, 5, 0), np.delete(depth_m, 5, 0), rtol=1e-4)
    assert not smooth_planes(np.zeros((3, 4), np.float32), windows_px=(2,), noise_m=0.02).any()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"windows_px": ()}, "windows_px must hold one window"),
        ({"windows_px": (0,)}, "at least 1 pixel"),
        ({"windows_px": (10**9,)}, "windows_px must be at most"),
        ({"windows_px": (1,) * 100}, "number of smoothing.windows_px must be at most"),
        ({"noise_m": -0.1}, "noise_m must be at least 0"),
        ({"noise_m": float("nan")}, "noise_m must be at least 0"),
    ],
)
def test_settings_that_cannot_be_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        PlaneSmoothing(**settings)

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sightline.geometry.road_height import drive_height_m, road_height_m
from tests.data.recordings import POINTS


def road(rng, *, height_m, slope_x, slope_y, num_points=3000):
    """A tilted road ahead, some of it under cars, with walls at both sides."""
    x, y = rng.uniform(4, 30, num_points), rng.uniform(-10, 10, num_points)
    z = -height_m + slope_x * x + slope_y * y + rng.normal(0, 0.02, num_points)
    under_a_car = (x > 12) & (x < 18) & (np.abs(y) < 4)
    z[under_a_car] += 1.5
    wall = np.column_stack(
        (rng.uniform(4, 30, 800), rng.choice((-11.0, 11.0), 800), rng.uniform(-1, 3, 800))
    )
    return np.concatenate((np.column_stack((x, y, z)), wall)).astype(np.float32)


@settings(max_examples=30)
@given(
    height_m=st.floats(0.6, 3.5),
    slope_x=st.floats(-0.03, 0.03),
    slope_y=st.floats(-0.03, 0.03),
    seed=st.integers(0, 99),
)
def test_the_height_above_a_sloping_road_is_told_to_a_decimetre(height_m, slope_x, slope_y, seed):
    points = road(np.random.default_rng(seed), height_m=height_m, slope_x=slope_x, slope_y=slope_y)
    assert road_height_m(points) == pytest.approx(height_m, abs=0.1)


@pytest.mark.parametrize("up_m", [-0.5, 0.0, 0.6])
def test_a_simulated_sweep_tells_how_high_its_lidar_sits(up_m):
    assert road_height_m(POINTS - np.float32([0, 0, up_m, 0])) == pytest.approx(
        1.73 + up_m, abs=0.15
    )


def test_where_no_road_is_seen_nothing_is_told():
    rng = np.random.default_rng(0)
    assert road_height_m(POINTS[:0]) is None
    assert road_height_m(POINTS[:20]) is None
    assert road_height_m(rng.uniform((4, -20, 0), (30, 20, 3), (5000, 3))) is None
    assert drive_height_m([POINTS[:0]]) is None


@pytest.mark.parametrize("z", [np.inf, -np.inf, np.nan, 1e30])
def test_points_that_are_none_do_not_hide_the_road(z):
    odd = np.float32([(10, 25, z, 0), (29.5, 0.5, z, 0)])  # where there is no other point
    assert road_height_m(np.concatenate((POINTS, odd))) == road_height_m(POINTS)


def test_a_drive_tells_the_median_of_its_sweeps():
    sweeps = [POINTS - np.float32([0, 0, up_m, 0]) for up_m in (0.0, 0.1, 2.0)]
    assert drive_height_m([*sweeps, POINTS[:0]]) == road_height_m(sweeps[1])

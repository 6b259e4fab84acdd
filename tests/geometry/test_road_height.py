import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sightline.geometry.road_height import (
    describe_odd_height,
    drive_height_m,
    lidar_pose,
    mount_doubts,
    road_height_m,
    road_plane,
    upright_turn,
)
from sightline.geometry.tilt import Tilt
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
    assert road_height_m(rng.uniform((4, -20, 1), (30, 20, 4), (5000, 3))) is None
    assert drive_height_m([POINTS[:0]]) is None


@pytest.mark.parametrize("z", [np.inf, -np.inf, np.nan, 1e30])
def test_points_that_are_none_do_not_hide_the_road(z):
    odd = np.float32([(10, 25, z, 0), (29.5, 0.5, z, 0)])  # where there is no other point
    assert road_height_m(np.concatenate((POINTS, odd))) == road_height_m(POINTS)


def test_a_drive_tells_the_median_of_its_sweeps():
    sweeps = [POINTS - np.float32([0, 0, up_m, 0]) for up_m in (0.0, 0.1, 2.0)]
    assert drive_height_m([*sweeps, POINTS[:0]]) == road_height_m(sweeps[1])


@pytest.mark.parametrize(
    ("roll_deg", "pitch_deg"), [(0, 6), (0, -12), (3, 12), (0, 20), (-15, 0), (10, 10)]
)
def test_a_tilted_lidar_has_the_road_that_a_level_one_has(roll_deg, pitch_deg):
    tilt = Tilt(roll_deg=float(roll_deg), pitch_deg=float(pitch_deg))
    level, tilted = road_plane(POINTS), road_plane(tilted_cloud(tilt))
    assert tilted.height_m == pytest.approx(level.height_m, abs=0.1)
    expected = tilt.level_from_lidar[:3, :3].T @ level.tilt.up
    assert tilted.tilt.up @ expected > np.cos(np.radians(1.0))
    pose = lidar_pose([tilted_cloud(tilt)])
    assert pose.height_m == pytest.approx(1.73, abs=0.15)
    assert pose.tilt is not None


def test_a_level_lidar_and_one_that_is_hardly_tilted_have_no_tilt():
    assert lidar_pose([POINTS]).tilt is None
    assert lidar_pose([tilted_cloud(Tilt(roll_deg=0.5, pitch_deg=1.0))] * 5).tilt is None
    assert lidar_pose([POINTS]).height_m == road_height_m(POINTS)


@pytest.mark.parametrize("height_m", [5.3, 7.0, 9.5])
@pytest.mark.parametrize("pitch_deg", [0.0, 12.0])
def test_a_lidar_on_a_mast_has_the_road_that_one_on_a_car_has(height_m, pitch_deg):
    tilt = Tilt(roll_deg=0.0, pitch_deg=pitch_deg)
    raised = POINTS[:, :3] - np.float32([0, 0, height_m - 1.73])
    cloud = raised.astype(np.float64) @ tilt.level_from_lidar[:3, :3]
    pose = lidar_pose([cloud])
    assert pose.height_m == pytest.approx(height_m, abs=0.2)
    assert (0.0 if pose.tilt is None else pose.tilt.pitch_deg) == pytest.approx(pitch_deg, abs=1.5)
    assert upright_turn(cloud) is None
    assert "lidar_height_m is 1.73, but the road" in str(mount_doubts([cloud], 1.73, None)[0])


def test_a_road_far_below_counts_only_where_no_sweep_shows_one_near():
    assert repr(lidar_pose([POINTS, POINTS - np.float32([0, 0, 6, 0])])) == repr(
        lidar_pose([POINTS])
    )


def test_noise_has_no_road_far_below():
    rng = np.random.default_rng(0)
    clouds = [rng.uniform((-30, -30, -10), (30, 30, 10), (5000, 3)) for _ in range(3)]
    assert all(road_plane(cloud, 10.0) is None for cloud in clouds)


def test_a_tilt_that_is_given_is_kept():
    given_tilt = Tilt(roll_deg=0.0, pitch_deg=1.0)
    assert lidar_pose([tilted_cloud(given_tilt)], given_tilt).tilt == given_tilt
    assert lidar_pose([POINTS[:0]], given_tilt).height_m is None


def test_a_few_sweeps_that_lie_do_not_tilt_a_drive():
    aslant = tilted_cloud(Tilt(roll_deg=0.0, pitch_deg=10.0))
    assert lidar_pose([POINTS, POINTS, POINTS, aslant, aslant]).tilt is None


def test_a_cloud_whose_origin_lies_on_the_road_has_a_height_of_zero():
    lifted = POINTS + np.float32([0, 0, 1.73, 0])
    assert road_height_m(lifted) == pytest.approx(0, abs=0.15)


@pytest.mark.parametrize("rows", [[[1, 0, 0], [0, -1, 0], [0, 0, -1]], np.eye(3)])
def test_the_turn_that_makes_a_cloud_upright_is_found(rows):
    found = upright_turn(POINTS[:, :3] @ np.array(rows))
    assert (found is None) == np.array_equal(rows, np.eye(3))
    if found is not None:
        np.testing.assert_array_equal(found, rows)


def tilted_cloud(tilt):
    """The simulated sweep from a LiDAR with this tilt."""
    return POINTS[:, :3].astype(np.float64) @ tilt.level_from_lidar[:3, :3]


@pytest.mark.parametrize(
    ("height_m", "is_doubted"),
    [(0.51, True), (0.0, False), (1.73, False), (4.9, False), (5.7, True), (7.0, False)],
)
def test_a_height_of_points_in_feet_is_doubted_and_an_origin_on_the_road_is_not(
    height_m, is_doubted
):
    doubt = describe_odd_height(height_m)
    cause = "on a mast" if height_m > 5 else "vehicle's frame"
    assert ("in feet" in doubt) == (cause in doubt) == is_doubted


@pytest.mark.parametrize(
    ("error_m", "is_doubted"), [(0.0, False), (0.1, False), (0.3, True), (-0.3, True), (0.5, True)]
)
def test_a_given_height_is_doubted_from_a_quarter_of_a_metre(error_m, is_doubted):
    points = road(np.random.default_rng(0), height_m=1.73, slope_x=0.0, slope_y=0.0)
    assert bool(mount_doubts([points], 1.73 + error_m, None)) == is_doubted


def test_a_height_below_the_road_is_doubted_one_on_it_is_not():
    assert "no LiDAR is below the road" in describe_odd_height(-0.17)
    assert not describe_odd_height(-0.05)

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sightline.health.lidar_checks import (
    CELL_DEG,
    NOTHING,
    WIDEST_DEG,
    LidarChecks,
    _compare_neighbours,
    bad_sweep_regions,
    blind_sectors,
    cell_counts,
    check_lidar,
)
from sightline.health.sphere import to_sphere
from tests.health.frames import sound
from tests.reference import health as reference


def rng():
    return np.random.default_rng(0)


def azimuth_of(points):
    return np.degrees(np.arctan2(points[:, 1], points[:, 0]))


def moved(points, deviation_m, share=1.0):
    chosen = rng().random(len(points)) < share
    points[:, :3] += chosen[:, None] * rng().normal(0, deviation_m, (len(points), 3))
    return points


def pulled(points, share, nearest_m=3.0):
    """Shorten the ranges of some returns."""
    chosen = rng().random(len(points)) < share
    ranges = np.linalg.norm(points[:, :3], axis=1)
    factor = np.where(chosen, rng().uniform(nearest_m, 8, len(points)) / ranges, 1)
    points[:, :3] *= np.minimum(factor, 1)[:, None]
    return points


def every_so_manyth_ring(points, keep_every):
    ring = np.cumsum(np.diff(azimuth_of(points), prepend=0) < -30)
    return points[ring % keep_every == 0]


FAULTS = {
    "sparse": (lambda p, x: p[rng().random(len(p)) >= x], (0, 0.4, 0.8)),
    "ringless": (every_so_manyth_ring, (1, 2, 4)),
    "gappy": (lambda p, x: p[rng().random(len(p)) >= x], (0, 0.1, 0.2)),
    "holes": (lambda p, x: p[np.abs(azimuth_of(p)) >= x], (0, 6, 15)),
    "narrow": (lambda p, x: p[np.abs(azimuth_of(p)) <= x], (50, 30, 10)),
    "rough": (moved, (0, 0.03, 0.1)),
    "spiky": (pulled, (0, 0.02, 0.1)),
    "stray": (lambda p, x: moved(p, 3.0, x), (0, 0.01, 0.05)),
    "jagged": (moved, (0, 0.03, 0.1)),
    "cluttered": (pulled, (0, 0.02, 0.1)),
    "short": (lambda p, x: p[np.linalg.norm(p[:, :3], axis=1) < x], (100, 30, 10)),
    "faded": (lambda p, x: p * np.array([1, 1, 1, x], np.float32), (1, 0.5, 0.1)),
}


@pytest.mark.parametrize("name", FAULTS)
def test_each_check_grows_with_what_it_looks_for(name):
    fault, amounts = FAULTS[name]
    found = []
    for amount in amounts:
        points = np.ascontiguousarray(fault(sound().points.numpy().copy(), amount), np.float32)
        found.append(getattr(check_lidar(points), name))
    assert found[0] < found[1] < found[2]


def test_all_checks_have_a_fault_but_that_of_whole_turns():
    assert {*FAULTS, "blind"} == {*LidarChecks._fields}


@given(
    steps=st.lists(
        st.tuples(
            st.sampled_from([0.2, 0.2, 0.2, 0.4, -0.3, -70.0]),  # of azimuth
            st.sampled_from([5.0, 5.0, 5.02, 5.5, 3.0, 30.0]),  # ranges
            st.sampled_from([0.0, 0.0, 0.05, 0.5, 3.0]),  # elevations
            st.sampled_from([-1.6, 0.0]),  # heights
        ),
        max_size=30,
    )
)
def test_neighbours_are_compared_as_by_a_plain_loop(steps):
    columns = np.array(steps, dtype=np.float64).reshape(len(steps), 4)
    azimuth, ranges, elevation, height = columns.T.copy()
    azimuth = np.cumsum(azimuth)
    found = _compare_neighbours(ranges, azimuth, elevation, height)
    expected = reference.neighbours(ranges, azimuth, elevation, height)
    assert found[0].tolist() == pytest.approx(expected[0])
    assert found[1:] == expected[1:]


@pytest.mark.parametrize("count", [0, 1, 2])
def test_a_sweep_of_hardly_any_points_is_nothing(count):
    points = np.ones((count, 4), np.float32)
    assert check_lidar(points) == NOTHING


@pytest.mark.parametrize("count", [3, 4, 50])
def test_points_at_one_place_are_judged(count):
    for place in ((0, 0, 0), (5, 0, 0), (20, 5, 5)):
        points = np.full((count, 4), 0.5, np.float32)
        points[:, :3] = place
        checks = check_lidar(points)
        assert np.isfinite([each for each in checks if not np.isnan(each)]).all() == any(place)


def test_sweeps_are_judged_alike_whether_they_are_cut_to_the_view_or_whole():
    points = sound().points.numpy()
    behind = points * np.array([-1, 1, 1, 1], np.float32)
    assert check_lidar(np.concatenate((points, behind)))[:-1] == check_lidar(points)[:-1]


def test_fog_is_told_by_what_it_takes_from_far_returns_and_by_nothing_where_there_are_none():
    points = sound().points.numpy()
    ranges = np.linalg.norm(points[:, :3], axis=1)
    far = points.copy()
    far[ranges < 15, 3] = 0
    assert check_lidar(far).faded == check_lidar(points).faded
    assert np.isnan(check_lidar(points[ranges < 15]).faded)


def test_points_are_counted_in_their_cells():
    azimuth = np.array([38.5, -38.5, 0.0, 90.0])
    elevation = np.array([-1.5, -11.5, -5.0, -5.0])
    counts = cell_counts(azimuth.astype(np.float32), elevation.astype(np.float32))
    assert counts.shape == (11, round(2 * WIDEST_DEG / CELL_DEG))
    assert counts[0, 0] == counts[-1, -1] == counts[4, round(WIDEST_DEG / CELL_DEG)] == 1
    assert counts.sum() == 3


def test_a_hole_in_the_sweep_is_found_where_it_is():
    points = sound().points.numpy()
    _, azimuth, _ = to_sphere(points)
    regions = bad_sweep_regions(points[(azimuth < 10) | (azimuth > 20)])
    left, right = (round((WIDEST_DEG - edge) / CELL_DEG) for edge in (20, 10))
    assert regions[3:, left:right].all()
    assert regions[3:, : left - 1].mean() < 0.2


def test_blind_sectors_are_those_of_a_whole_turn_alone():
    angles = np.radians(np.arange(-180, 180, 0.5) + 0.25)
    turn = np.stack((np.cos(angles), np.sin(angles), 0 * angles, 0 * angles), axis=1)
    turn = turn.astype(np.float32)
    assert not blind_sectors(turn).any()
    kept = turn[(np.degrees(angles) < 90) | (np.degrees(angles) > 100)]
    assert np.flatnonzero(blind_sectors(kept)).tolist() == [135, 136, 137, 138, 139]
    assert not blind_sectors(turn[np.abs(np.degrees(angles)) < 40]).any()

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.health.lidar_checks import check_lidar, is_ahead
from sightline.health.ring_order import number_rings, ring_by_ring
from sightline.health.sphere import to_sphere
from sightline.health.yaw_error import match_edges
from tests.health.frames import sound


def origin_lidar(step_deg=1.0):
    """The packaged sweep as lasers of one origin would have taken it, ring by ring."""
    points = sound().points.numpy()
    points = points[is_ahead(points)]
    ranges, azimuth, elevation = to_sphere(points)
    rings = np.rint(elevation / step_deg)
    kept = np.abs(elevation - rings * step_deg) < 0.15
    tilt, turn = np.radians(rings * step_deg), np.radians(azimuth)
    rays = (np.cos(tilt) * np.cos(turn), np.cos(tilt) * np.sin(turn), np.sin(tilt))
    moved = np.stack((*(ranges * each for each in rays), points[:, 3]), axis=1)[kept]
    order = np.lexsort((azimuth[kept], -rings[kept]))
    return moved[order].astype(np.float32)


ORDERS = {
    "as it is": lambda points: points,
    "backwards": lambda points: points[::-1].copy(),
    "by shots": lambda points: points[np.argsort(to_sphere(points)[1], kind="stable")],
    "shuffled": lambda points: np.random.default_rng(0).permutation(points),
}


@pytest.mark.parametrize("order", ORDERS)
def test_sweeps_in_any_order_become_the_same(order):
    points = origin_lidar()
    assert np.array_equal(ring_by_ring(ORDERS[order](points)), points)


@pytest.mark.parametrize("order", ORDERS)
def test_sweeps_in_any_order_are_judged_alike(order):
    points = origin_lidar()
    changed = ORDERS[order](points)
    assert check_lidar(changed) == check_lidar(points)
    first, second = (
        match_edges(replace(sound(), points=torch.from_numpy(each))) for each in (points, changed)
    )
    assert np.array_equal(first.curves, second.curves)
    assert np.array_equal(first.tops.strengths, second.tops.strengths)
    assert first.tops.weights.any()


@pytest.mark.parametrize("order", ["by shots", "shuffled", "column by column"])
def test_a_sweep_of_an_hdl_64e_in_another_order_is_judged_as_in_its_own(order):
    points = sound().points.numpy()
    if order == "column by column":
        _, azimuth, elevation = to_sphere(points)
        changed = points[np.lexsort((-elevation, np.floor(azimuth / 0.5)))]
    else:
        changed = ORDERS[order](points)
    expected, found = check_lidar(points), check_lidar(changed)
    assert 2**-found.ringless == pytest.approx(2**-expected.ringless, abs=1.5)
    np.testing.assert_allclose(found, expected, atol=0.1)


def test_a_sweep_of_lasers_apart_from_each_other_stays_in_its_order():
    points = sound().points.numpy()
    ahead = points[is_ahead(points)]
    assert np.array_equal(ring_by_ring(ahead), ahead)
    noisy = ahead + np.random.default_rng(0).normal(0, 0.1, ahead.shape).astype(np.float32)
    assert np.array_equal(ring_by_ring(noisy), noisy)


@given(count=st.integers(0, 300), seed=st.integers(0, 100), place=st.sampled_from([0.0, 5.0, 1e4]))
def test_the_points_stay_the_same(count, seed, place):
    drawn = np.random.default_rng(seed).normal(place, 3, (count, 4)).astype(np.float32)
    found = ring_by_ring(drawn)
    assert sorted(map(tuple, found)) == sorted(map(tuple, drawn))


def test_rings_begin_where_the_azimuth_falls_back():
    azimuth = np.array([0, 10, 36, -36, -20, 1, 30, -30], np.float32)
    assert number_rings(azimuth).tolist() == [0, 0, 0, 1, 1, 1, 1, 2]
    assert number_rings(azimuth[:0]).tolist() == []

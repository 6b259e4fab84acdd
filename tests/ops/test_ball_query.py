"""Ball query against a loop over all points, and against all distances."""

import inspect
import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.ops.ball_query import ball_query
from tests.ops.clouds import as_batch, clouds, street
from tests.reference import point_ops as reference
from tests.reference import point_search


@given(
    points=clouds(),
    centers=clouds(max_size=4),
    radius_m=st.sampled_from([1e-3, 1.0, math.sqrt(2), 3.0, 1e3]),
    count=st.integers(1, 6),
)
def test_the_first_points_in_reach_are_found_and_the_first_fills_up(
    points, centers, radius_m, count
):
    expected = [reference.ball_query(points, center, radius_m, count) for center in centers]
    cloud, around = as_batch(points), as_batch(centers)
    index, num_found = ball_query(cloud, around, radius_m=radius_m, count=count)
    assert index[0].tolist() == [row for row, _ in expected]
    assert num_found[0].tolist() == [found for _, found in expected]


@pytest.mark.parametrize("radius_m", [0.1, 0.5, 2.0, 30.0])
@pytest.mark.parametrize("count", [1, 16, 700])
def test_the_grid_loses_no_point_of_a_street(radius_m, count):
    cloud = street(3, 600)
    around = torch.cat((cloud[:, :40], cloud[:, :40] + 5), dim=1)
    found = ball_query(cloud, around, radius_m=radius_m, count=count)
    index, num_found = point_search.ball_query(cloud[0], around[0], radius_m, count)
    assert torch.equal(found.indices[0], index)
    assert torch.equal(found.num_found[0], num_found)


def test_a_point_at_the_radius_itself_is_outside():
    cloud = as_batch([(0, 0, 0), (1, 0, 0), (0.999, 0, 0)])
    found = ball_query(cloud, cloud[:, :1], radius_m=1.0, count=3)
    assert found.indices.tolist() == [[[0, 2, 0]]]
    assert found.num_found.tolist() == [[2]]


@pytest.mark.parametrize("threads", [1, 4])
def test_each_cloud_of_a_batch_has_centers_of_its_own(monkeypatch, threads):
    monkeypatch.setattr(torch, "get_num_threads", lambda: threads)
    cloud = torch.cat((street(0, 90), street(1, 90)))
    both = ball_query(cloud, cloud[:, :7], radius_m=2.0, count=5)
    for sweep in (0, 1):
        part = slice(sweep, sweep + 1)
        alone = ball_query(cloud[part], cloud[part, :7], radius_m=2.0, count=5)
        assert torch.equal(both.indices[part], alone.indices)


def test_a_center_far_beside_all_points_finds_nothing():
    centers = as_batch([(1e9, -1e9, 0), (-1e9, 0, 1e9)])
    found = ball_query(as_batch([(0, 0, 0), (1e-30, 0, 0)]), centers, radius_m=1e-20, count=2)
    assert found.num_found.tolist() == [[0, 0]]


def test_what_cannot_be_asked_is_refused():
    cloud = street(0, 9)
    for radius_m in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(ValueError, match="radius_m must be positive and finite, got"):
            ball_query(cloud, cloud, radius_m=radius_m, count=2)
    with pytest.raises(ValueError, match="count must be at least 1, got 0"):
        ball_query(cloud, cloud, radius_m=1.0, count=0)
    with pytest.raises(ValueError, match="batch sizes differ: points 1, centers 2"):
        inspect.unwrap(ball_query)(cloud, cloud.expand(2, -1, -1), radius_m=1.0, count=1)
    centers = cloud.clone()
    centers[0, 8, 2] = math.nan
    with pytest.raises(ValueError, match=r"^centers\[0, 8\] is .* must be finite"):
        ball_query(cloud, centers, radius_m=1.0, count=1)

"""Farthest point sampling, against the plain rule."""

import inspect
import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.ops.farthest_points import farthest_points
from tests.ops.clouds import as_batch, clouds, street
from tests.reference import point_ops as reference
from tests.reference import point_search


@given(points=clouds(min_size=1), count=st.integers(0, 15))
def test_each_point_is_the_farthest_from_those_before_it_even_at_ties(points, count):
    expected = reference.farthest_points(points, count)
    cloud = as_batch(points)
    assert farthest_points(cloud, count).tolist() == [expected]
    if count:
        assert point_search.farthest_points(cloud, count).tolist() == [expected]


@pytest.mark.parametrize("num_points", [128, 129, 1000, 1531])
@pytest.mark.parametrize("seed", range(3))
def test_the_leaves_of_large_clouds_change_nothing(num_points, seed):
    cloud = street(seed, num_points)
    plain = point_search.farthest_points(cloud, num_points + 5)
    assert torch.equal(farthest_points(cloud, num_points + 5), plain)
    assert len(set(plain[0, :num_points].tolist())) == num_points
    on_a_grid = cloud.round()  # thousands of ties, most points several times
    assert torch.equal(
        farthest_points(on_a_grid, 300), point_search.farthest_points(on_a_grid, 300)
    )


def test_a_large_cloud_is_sampled_as_the_reference_says():
    cloud = street(7, 700)
    expected = reference.farthest_points(cloud[0].tolist(), 60)
    assert farthest_points(cloud, 60).tolist() == [expected]


@pytest.mark.parametrize("threads", [1, 4])
def test_each_cloud_of_a_batch_is_sampled_by_itself(monkeypatch, threads):
    monkeypatch.setattr(torch, "get_num_threads", lambda: threads)
    clouds_of_batch = torch.cat((street(0, 200), street(1, 200)))
    both = farthest_points(clouds_of_batch, 50)
    assert torch.equal(both[:1], farthest_points(clouds_of_batch[:1], 50))
    assert torch.equal(both[1:], farthest_points(clouds_of_batch[1:], 50))
    assert torch.equal(both, point_search.farthest_points(clouds_of_batch, 50))


def test_where_points_run_out_point_0_is_taken_again():
    cloud = as_batch([(0, 0, 0), (2, 0, 0), (2, 0, 0), (1, 0, 0)])
    assert farthest_points(cloud, 6).tolist() == [[0, 1, 3, 0, 0, 0]]


def test_no_clouds_and_no_count_give_nothing():
    assert farthest_points(torch.zeros(0, 5, 3), 4).shape == (0, 4)
    assert farthest_points(torch.zeros(2, 0, 3), 0).shape == (2, 0)


def test_what_cannot_be_sampled_is_refused():
    cloud = street(0, 9)
    with pytest.raises(ValueError, match="count must not be negative, got -1"):
        farthest_points(cloud, -1)
    with pytest.raises(ValueError, match="points is empty, but count is 4"):
        farthest_points(cloud[:, :0], 4)
    with pytest.raises(ValueError, match=r"points must be .* got torch.float32 of shape \(1, 9, 2"):
        inspect.unwrap(farthest_points)(cloud[..., :2], 4)
    for value in (math.nan, math.inf, -2e9):
        cloud[0, 3, 1] = value
        with pytest.raises(ValueError, match=r"^points\[0, 3\] is \[.* must be finite"):
            farthest_points(cloud, 4)


def test_infinities_are_refused_in_half_precision_too():
    cloud = street(0, 9).half()
    cloud[0, 3, 1] = math.inf
    with pytest.raises(ValueError, match=r"^points\[0, 3\] is \["):
        farthest_points(cloud, 4)

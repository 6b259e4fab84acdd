"""The three nearest points, and features between them."""

import inspect
import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.ops.interpolate_points import interpolate_points
from sightline.ops.three_nearest import ThreeNearest, three_nearest
from tests.ops.clouds import as_batch, clouds, street
from tests.reference import point_ops as reference
from tests.reference import point_search


@given(points=clouds(min_size=1), queries=clouds(max_size=4))
def test_the_three_nearest_are_found_equal_ones_in_their_order(points, queries):
    expected = [reference.three_nearest(points, query) for query in queries]
    cloud, query_batch = as_batch(points), as_batch(queries)
    found = three_nearest(cloud, query_batch)
    assert found.indices[0].tolist() == [index for index, _ in expected]
    assert found.squared_distance_m2[0].tolist() == [distance for _, distance in expected]


def test_the_grid_loses_no_neighbour_of_a_street():
    cloud, queries = street(0, 500), street(1, 400)
    far = torch.tensor([[[1e9, -1e9, 0], [-1e6, 3, 2], [0, 1e3, -1e3]]])
    all_queries = torch.cat((queries, cloud[:, :50], far), dim=1)
    found = three_nearest(cloud, all_queries)
    index, squared_distance = point_search.three_nearest(cloud[0], all_queries[0])
    assert torch.equal(found.indices[0], index)
    assert torch.equal(found.squared_distance_m2[0], squared_distance)


@given(points=clouds(min_size=1), queries=clouds(min_size=1, max_size=4), seed=st.integers(0, 9))
def test_features_are_means_weighted_by_inverse_squared_distances(points, queries, seed):
    features = torch.rand(1, len(points), 5, generator=torch.Generator().manual_seed(seed))
    mixed = interpolate_points(features, three_nearest(as_batch(points), as_batch(queries)))
    for query, got in zip(queries, mixed[0], strict=True):
        index, distances = reference.three_nearest(points, query)
        closeness = [1 / max(float(distance), 1e-10) for distance in distances]
        expected = sum(c * features[0, i] for c, i in zip(closeness, index, strict=True))
        torch.testing.assert_close(got, expected / sum(closeness), atol=1e-5, rtol=1e-5)


def test_a_query_on_a_point_takes_its_features():
    cloud = street(4, 50)
    features = torch.rand(1, 50, 6)
    torch.testing.assert_close(interpolate_points(features, three_nearest(cloud, cloud)), features)


def test_plain_pytorch_mixes_the_same_in_half_precision():
    cloud, queries = street(0, 40), street(1, 30)
    nearest = three_nearest(cloud, queries)
    features = torch.rand(1, 40, 8)
    mixed = interpolate_points(features.bfloat16(), nearest)
    assert mixed.dtype == torch.bfloat16
    torch.testing.assert_close(
        mixed.float(), interpolate_points(features, nearest), atol=2e-2, rtol=0
    )


def test_gradients_equal_finite_differences():
    cloud, queries = (
        torch.cat((street(0, 9), street(1, 9))),
        torch.cat((street(2, 6), street(3, 6))),
    )
    nearest = three_nearest(cloud, queries)
    features = torch.rand(2, 9, 3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda values: interpolate_points(values, nearest), features)


def test_no_queries_give_nothing_and_no_points_are_refused():
    cloud = street(0, 5)
    none = three_nearest(cloud[:, :0], cloud[:, :0])
    assert none.indices.shape == (1, 0, 3)
    assert interpolate_points(torch.rand(1, 0, 4), none).shape == (1, 0, 4)
    with pytest.raises(ValueError, match="points is empty, expected at least one"):
        three_nearest(cloud[:, :0], cloud)


def test_a_value_that_is_no_finite_number_is_refused():
    cloud, queries = street(0, 5), street(1, 5)
    queries[0, 4, 0] = math.nan
    with pytest.raises(ValueError, match=r"^queries\[0, 4\] is \[nan"):
        three_nearest(cloud, queries)
    with pytest.raises(ValueError, match=r"^points\[0, 4\] is \[nan"):
        three_nearest(queries, cloud)
    with pytest.raises(ValueError, match="index must be from 0 to 3"):
        interpolate_points(torch.rand(1, 4, 2), three_nearest(cloud, cloud))


def test_indices_and_distances_that_do_not_belong_together_are_refused():
    index, distance = torch.zeros(1, 4, 3, dtype=torch.int64), torch.ones(1, 4, 3)
    for wrong in (
        ThreeNearest(index, distance[:, :3]),
        ThreeNearest(index[..., :2], distance[..., :2]),
        ThreeNearest(index[:, 0], distance[:, 0]),
    ):
        with pytest.raises(ValueError, match="nearest must hold three indices"):
            inspect.unwrap(interpolate_points)(torch.rand(1, 5, 2), wrong)


def test_points_without_features_are_mixed_to_none():
    cloud = street(0, 5)
    features = torch.rand(1, 5, 0, requires_grad=True)
    mixed = interpolate_points(features, three_nearest(cloud, cloud[:, :2]))
    assert mixed.shape == (1, 2, 0)
    mixed.sum().backward()
    assert features.grad.shape == (1, 5, 0)

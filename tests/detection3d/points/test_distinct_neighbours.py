"""Distinct neighbours alone against the plain form with all of them."""

import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from sightline.detection3d.points.config import (
    AbstractionConfig,
    NeighbourhoodConfig,
    RefinementConfig,
)
from sightline.detection3d.points.layers import Neighbourhood, find_groupings
from sightline.detection3d.points.refinement import RefinementNetwork
from tests.reference.point_layers import neighbourhood

SCALE = NeighbourhoodConfig(radius_m=1.0, num_neighbours=8, widths=(6, 5))
LEVEL = AbstractionConfig(num_centers=12, scales=(SCALE,))
SMALL = RefinementConfig(in_channels=3, levels=(LEVEL, LEVEL), global_widths=(8,), head_widths=())


def layers_of(layer):
    return [(layer.first.weight, layer.first.bias), (layer.rest[0].weight, layer.rest[0].bias)]


@given(
    seed=st.integers(0, 999),
    channels=st.sampled_from([0, 3]),
    sweeps=st.integers(1, 3),
    num_points=st.integers(1, 9),
    count=st.integers(1, 7),
)
def test_repeated_neighbours_change_neither_values_nor_gradients(
    seed, channels, sweeps, num_points, count
):
    torch.manual_seed(seed)
    layer = Neighbourhood(channels, SCALE, batch_norm=False).double()
    points, centers = (
        torch.randn(sweeps, num_points, 3).double(),
        torch.randn(sweeps, 4, 3).double(),
    )
    features = torch.randn(sweeps, num_points, channels).double().requires_grad_()
    neighbours = torch.randint(num_points, (sweeps, 4, count))
    given_to = [*layer.parameters(), *([features] if channels else [])]
    found = layer(points, features, centers, neighbours)
    expected = neighbourhood(points, features, centers, neighbours, layers_of(layer))
    torch.testing.assert_close(found, expected)
    weights = torch.randn_like(found)
    own, plain = (
        torch.autograd.grad((each * weights).sum(), given_to) for each in (found, expected)
    )
    torch.testing.assert_close(own, plain)


@settings(max_examples=25)  # two networks each
@given(seed=st.integers(0, 999), distinct=st.integers(1, 20))
def test_copies_of_a_regions_points_change_nothing(seed, distinct):
    torch.manual_seed(seed)
    network = RefinementNetwork(SMALL).double()
    sources = torch.cat((torch.arange(distinct), torch.randint(distinct, (30 - distinct,))))[None]
    points, features = (torch.rand(1, distinct, width).double()[:, sources[0]] for width in (3, 3))
    with_copies, _ = find_groupings(points, network.levels)
    without, _ = find_groupings(points, network.levels, sources)
    same, other = (network(points, features, **found) for found in (with_copies, without))
    torch.testing.assert_close(tuple(other), tuple(same))
    for name in ("neighbours_0_0", "neighbours_1_0"):
        assert without[name].unique().numel() <= distinct


def test_a_batchs_statistics_count_every_neighbour_in_training_and_none_in_use():
    torch.manual_seed(0)
    layer = Neighbourhood(0, SCALE, batch_norm=True)
    points = torch.randn(1, 6, 3)
    neighbours = torch.tensor([[[0, 1, 1, 1], [2, 3, 4, 4]]])
    layer(points, points[..., :0], points[:, :2], neighbours)
    offsets = points[0, neighbours[0]] - points[0, :2, None]
    mean = (offsets.flatten(0, 1) @ layer.first.weight.T).mean(dim=0)
    torch.testing.assert_close(layer.activate.norm.running_mean, 0.1 * mean)
    layer.eval()
    repeated = torch.cat((neighbours, neighbours[..., :1]), dim=2)
    once, twice = (layer(points, points[..., :0], points[:, :2], e) for e in (neighbours, repeated))
    torch.testing.assert_close(twice, once)

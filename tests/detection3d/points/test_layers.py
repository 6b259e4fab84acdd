"""Layers of point networks against loops, and what must not matter to them."""

from dataclasses import replace

import pytest
import torch
from torch.nn.functional import linear

from sightline.detection3d.points.config import (
    AbstractionConfig,
    NeighbourhoodConfig,
    PointBackboneConfig,
)
from sightline.detection3d.points.layers import (
    FeaturePropagation,
    Neighbourhood,
    NormAndRelu,
    PointBackbone,
    PointFeatures,
    SetAbstraction,
    abstract,
    find_groupings,
)
from sightline.ops.three_nearest import three_nearest
from tests.ops.clouds import street
from tests.reference import point_ops as reference

SCALE = NeighbourhoodConfig(radius_m=2.0, num_neighbours=5, widths=(6, 4))
TINY = PointBackboneConfig(
    in_channels=1,
    levels=(
        AbstractionConfig(num_centers=64, scales=(SCALE, SCALE)),
        AbstractionConfig(num_centers=16, scales=(SCALE,)),
    ),
    propagation_widths=((7, 5), (6,)),
)


def run(network, points, features):
    return network(points, features, network.find(points))


@pytest.mark.parametrize("channels", [0, 3])
def test_a_center_takes_the_largest_values_of_its_neighbours(channels):
    torch.manual_seed(0)
    cloud = street(1, 80)
    features = torch.randn(1, 80, channels)
    layer = Neighbourhood(channels, SCALE, batch_norm=False)
    seen = layer(cloud, features, cloud[:, :9], layer.find(cloud, cloud[:, :9]))
    for m, center in enumerate(cloud[0, :9]):
        near, _ = reference.ball_query(cloud[0].tolist(), center.tolist(), 2.0, 5)
        rows = []
        for point in near:
            both = torch.cat((cloud[0, point] - center, features[0, point]))
            hidden = linear(both, layer.first.weight, layer.first.bias).relu()
            rows.append(linear(hidden, layer.rest[0].weight, layer.rest[0].bias).relu())
        torch.testing.assert_close(seen[0, m], torch.stack(rows).amax(dim=0), atol=1e-5, rtol=1e-4)


def test_a_level_has_farthest_points_and_all_scales_side_by_side():
    torch.manual_seed(0)
    cloud, features = street(0, 200), torch.randn(1, 200, 2)
    config = AbstractionConfig(num_centers=12, scales=(SCALE, SCALE))
    layer = SetAbstraction(2, config, batch_norm=True).eval()
    level = layer(cloud, features, layer.find(cloud))
    expected = cloud[0, reference.farthest_points(cloud[0].tolist(), 12)]
    assert torch.equal(level.points[0], expected)
    assert level.features.shape == (1, 12, config.out_channels)
    for k, scale in enumerate(layer.scales):
        part = level.features[..., 4 * k : 4 * k + 4]
        torch.testing.assert_close(
            part, scale(cloud, features, level.points, scale.find(cloud, level.points))
        )


def test_each_of_more_than_ten_scales_gets_its_own_neighbours():
    radii = [0.5 + 0.25 * k for k in range(12)]
    scales = tuple(replace(SCALE, radius_m=radius_m) for radius_m in radii)
    level = SetAbstraction(0, AbstractionConfig(num_centers=16, scales=scales), batch_norm=False)
    cloud = street(2, 120)
    given = PointFeatures(cloud, torch.zeros(1, 120, 0))
    found, _ = find_groupings(cloud, torch.nn.ModuleList([level]))
    _, named = abstract(given, torch.nn.ModuleList([level]), found)
    own = level(*given, level.find(cloud))
    assert torch.equal(named.features, own.features)


def test_finer_points_get_what_lies_between_and_keep_what_they_have():
    torch.manual_seed(0)
    coarse = PointFeatures(street(0, 10), torch.randn(1, 10, 4))
    fine = PointFeatures(
        torch.cat((coarse.points[:, :3], street(1, 5)), dim=1), torch.randn(1, 8, 2)
    )
    layer = FeaturePropagation(6, (5,), batch_norm=False)
    nearest = three_nearest(coarse.points, fine.points)
    got = layer(coarse.features, fine.features, nearest)
    at_points = torch.cat((coarse.features[0, :3], fine.features[0, :3]), dim=1)
    expected = linear(at_points, layer.layers[0].weight, layer.layers[0].bias).relu()
    torch.testing.assert_close(got[0, :3], expected)


@pytest.mark.parametrize("num_points", [1, 2, 17, 300])
def test_the_backbone_takes_any_number_of_points(num_points):
    torch.manual_seed(0)
    network = PointBackbone(TINY).eval()
    cloud = street(0, num_points)
    features = run(network, cloud, torch.rand(1, num_points, 1))
    assert features.shape == (1, num_points, 5)
    assert features.isfinite().all()


def test_sweeps_of_a_batch_do_not_see_each_other():
    torch.manual_seed(0)
    network = PointBackbone(TINY).eval()
    clouds, reflectance = torch.cat((street(0, 90), street(1, 90))), torch.rand(2, 90, 1)
    both = run(network, clouds, reflectance)
    torch.testing.assert_close(run(network, clouds[:1], reflectance[:1]), both[:1])
    torch.testing.assert_close(run(network, clouds[1:], reflectance[1:]), both[1:])


def test_a_street_moved_as_a_whole_has_the_same_features():
    torch.manual_seed(0)
    network = PointBackbone(TINY).eval().double()
    cloud, reflectance = street(0, 200).double(), torch.rand(1, 200, 1).double()
    moved = cloud + torch.tensor([4.0, -8.0, 1.0])
    torch.testing.assert_close(
        run(network, moved, reflectance), run(network, cloud, reflectance), atol=1e-4, rtol=1e-4
    )


def test_every_weight_of_the_backbone_learns():
    torch.manual_seed(0)
    network = PointBackbone(TINY)
    run(network, street(0, 200), torch.rand(1, 200, 1)).square().sum().backward()
    assert all(weight.grad.abs().sum() > 0 for weight in network.parameters())


def test_the_published_sizes_are_the_default():
    network = PointBackbone(PointBackboneConfig())
    assert PointBackboneConfig().out_channels == 128
    assert 2.5e6 < sum(weight.numel() for weight in network.parameters()) < 4e6


def test_settings_out_of_range_are_refused():
    with pytest.raises(ValueError, match="radius_m must be positive and up to 1000, got 0"):
        NeighbourhoodConfig(radius_m=0.0, num_neighbours=1, widths=(1,))
    with pytest.raises(ValueError, match="num_neighbours must be at least 1, got 0"):
        NeighbourhoodConfig(radius_m=1.0, num_neighbours=0, widths=(1,))
    with pytest.raises(ValueError, match=r"widths must hold one positive width a layer, got \(\)"):
        NeighbourhoodConfig(radius_m=1.0, num_neighbours=1, widths=())
    with pytest.raises(ValueError, match="scales must hold one neighbourhood or more"):
        AbstractionConfig(num_centers=1, scales=())
    with pytest.raises(ValueError, match="num_centers must be from 1 to 65536, got 0"):
        AbstractionConfig(num_centers=0, scales=(SCALE,))
    wide = NeighbourhoodConfig(radius_m=1.0, num_neighbours=10**6, widths=(64,))
    with pytest.raises(ValueError, match="a layer of 64000000000 numbers, expected up to 53687091"):
        AbstractionConfig(num_centers=1000, scales=(wide,))
    with pytest.raises(ValueError, match="one entry for each of one or more levels, got 1 for 4"):
        PointBackboneConfig(propagation_widths=((8,),))
    with pytest.raises(ValueError, match="in_channels must be at least 0, got -1"):
        PointBackboneConfig(in_channels=-1)


def test_the_gradient_of_a_normalised_layer_copies_no_view():
    layer, values = NormAndRelu(4, batch_norm=True), torch.randn(2, 3, 5, 4, requires_grad=True)
    out = layer(values)
    rows = values.detach().reshape(-1, 4)
    expected = ((rows - rows.mean(dim=0)) / (rows.var(dim=0, unbiased=False) + 1e-5).sqrt()).relu()
    torch.testing.assert_close(out.detach().reshape(-1, 4), expected)
    names, open_nodes = set(), [out.grad_fn]
    while open_nodes:
        node = open_nodes.pop()
        names.add(node.name())
        open_nodes += [parent for parent, _ in node.next_functions if parent is not None]
    assert "NativeBatchNormBackward0" in names
    assert "CopySlices" not in names


def test_learning_from_a_batch_gives_a_maximum_its_whole_gradient():
    torch.manual_seed(0)
    cloud, features = street(3, 80), torch.randn(1, 80, 3)
    layer = Neighbourhood(3, SCALE, batch_norm=True).train()
    near = layer.find(cloud, cloud[:, :9])
    out = layer(cloud, features, cloud[:, :9], near)
    out.sum().backward()
    found = [each.grad.clone() for each in layer.parameters()]
    layer.zero_grad()
    offsets = cloud[0][near[0]] - cloud[0, :9, None]
    rows = torch.cat((offsets, features[0][near[0]]), dim=2)
    plain = layer.rest(layer.activate(linear(rows, layer.first.weight)))
    plain.amax(dim=1).sum().backward()  # shares it among equal rows
    for gradient, each in zip(found, layer.parameters(), strict=True):
        torch.testing.assert_close(gradient, each.grad, atol=1e-5, rtol=1e-4)

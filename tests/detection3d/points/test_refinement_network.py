"""The second stage's network: its sizes, what it sees, and that it learns."""

import pytest
import torch

from sightline.detection3d.points.config import (
    AbstractionConfig,
    NeighbourhoodConfig,
    RefinementConfig,
    RefinementLossConfig,
)
from sightline.detection3d.points.layers import find_groupings
from sightline.detection3d.points.refinement import RefinementNetwork
from sightline.detection3d.points.refinement_training import box_loss, confidence_loss

SMALL = RefinementConfig(
    in_channels=4,
    levels=(
        AbstractionConfig(
            num_centers=16,
            scales=(NeighbourhoodConfig(radius_m=1.0, num_neighbours=8, widths=(16, 16)),),
        ),
    ),
    global_widths=(16, 32),
    head_widths=(16,),
)


def run(network, points, features):
    found, _ = find_groupings(points, network.levels)
    return network(points, features, **found)


def test_the_defaults_are_the_published_layers():
    network = RefinementNetwork(RefinementConfig())
    widths = [
        tuple(weight.shape) for name, weight in network.named_parameters() if "weight" in name
    ]
    assert widths == [
        (128, 131), (128, 128), (128, 131), (256, 128), (256, 259), (512, 256),
        (256, 512), (256, 256), (7, 256), (256, 512), (256, 256), (1, 256),
    ]  # fmt: skip
    boxes, logits = run(network, torch.rand(2, 512, 3), torch.rand(2, 512, 128))
    assert (boxes.shape, logits.shape) == ((2, 7), (2,))


def test_the_order_of_the_points_behind_the_first_does_not_matter():
    torch.manual_seed(0)
    network = RefinementNetwork(SMALL)
    points, features = 2 * torch.rand(1, 16, 3), torch.rand(1, 16, 4)  # all become centres
    wide = RefinementNetwork(SMALL)
    wide.load_state_dict(network.state_dict())
    order = torch.cat((torch.tensor([0]), 1 + torch.randperm(15)))
    near = network.levels[0].scales[0]
    near.num_neighbours = 16  # none is left out
    straight = run(network, points, features)
    shuffled = run(network, points[:, order], features[:, order])
    torch.testing.assert_close(shuffled.boxes, straight.boxes)
    torch.testing.assert_close(shuffled.logits, straight.logits)


def test_no_regions_give_no_boxes():
    boxes, logits = run(RefinementNetwork(SMALL), torch.zeros(0, 32, 3), torch.zeros(0, 32, 4))
    assert (boxes.shape, logits.shape) == ((0, 7), (0,))


def test_it_learns_the_boxes_of_a_few_regions_by_heart():
    torch.manual_seed(0)
    network = RefinementNetwork(SMALL)
    points, features = torch.randn(6, 32, 3), torch.randn(6, 32, 4)
    targets, iou = torch.randn(6, 7), torch.tensor([0.9, 0.8, 0.7, 0.6, 0.2, 0.0])
    optimizer = torch.optim.Adam(network.parameters(), lr=5e-3)
    config = RefinementLossConfig()
    for _ in range(200):
        output = run(network, points, features)
        loss = box_loss(output.boxes, targets, iou, config).total
        loss = loss + confidence_loss(output.logits, iou, config)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    output = run(network, points, features)
    assert (output.boxes[:4] - targets[:4]).abs().max() < 0.1
    assert ((output.logits > 0) == (iou >= 0.6)).all()


def test_settings_out_of_range_are_refused():
    with pytest.raises(ValueError, match=r"global_widths must hold one positive width a layer"):
        RefinementConfig(global_widths=())
    with pytest.raises(ValueError, match=r"head_widths must hold .* got \(0,\)"):
        RefinementConfig(head_widths=(0,))
    with pytest.raises(ValueError, match="in_channels must be at least 0, got -1"):
        RefinementConfig(in_channels=-1)


def test_an_untrained_network_tells_features_apart_and_puts_out_the_first_box():
    torch.manual_seed(0)
    network = RefinementNetwork(RefinementConfig())
    vectors = []
    network.together.register_forward_hook(lambda *call: vectors.append(call[2].amax(dim=1)))
    points = (torch.rand(1, 512, 3) * 3 + torch.tensor([30.0, 0.0, -1.0])).repeat(6, 1, 1)
    boxes, logits = run(network, points, torch.rand(6, 1, 128) * torch.rand(6, 512, 128))
    assert (boxes - torch.tensor(RefinementConfig().first_box)).abs().max() < 10
    assert logits.abs().max() < 5
    [vector] = vectors
    assert vector.std(dim=0).mean() / vector.mean() > 0.03  # 0.002 with PyTorch's own start


def test_mixed_precision_does_not_round_places():
    torch.manual_seed(0)
    network = RefinementNetwork(SMALL)
    points = torch.rand(2, 16, 3) + torch.tensor([40.0, 0.0, 0.0])
    whole = run(network, points, torch.rand(2, 16, 4))
    with torch.no_grad():
        network.box_head[-1].bias[0] = 40.1  # bfloat16: 40.0
        network.box_head[-1].weight.zero_()
    with torch.autocast("cpu", torch.bfloat16):
        mixed = run(network, points, torch.rand(2, 16, 4))
    assert whole.boxes.dtype == mixed.boxes.dtype == torch.float32
    assert mixed.boxes[:, 0].tolist() == pytest.approx([40.1, 40.1], abs=1e-4)


def test_a_first_box_has_seven_finite_numbers():
    with pytest.raises(ValueError, match="first_box must be 7 finite numbers"):
        RefinementConfig(first_box=(1.0, 2.0))

"""The first stage: its sizes, and that a small one learns a street by heart."""

import pytest
import torch

from sightline.data.datasets.kitti_object import KittiObjectDataset
from sightline.detection3d.classes import CAR, CYCLIST, PEDESTRIAN
from sightline.detection3d.points.box_coding import (
    ProposalNetworkOutput,
    encode_boxes,
    split_prediction,
)
from sightline.detection3d.points.config import (
    AbstractionConfig,
    FocalLossConfig,
    NeighbourhoodConfig,
    PointBackboneConfig,
    ProposalConfig,
    ProposalLossConfig,
    ProposalNetworkConfig,
)
from sightline.detection3d.points.proposal_training import focal_loss, proposal_loss
from sightline.detection3d.points.proposals import (
    ProposalNetwork,
    choose_proposals,
    decode_points,
)
from sightline.detection3d.training import find_recalled
from sightline.ops.points_in_boxes import first_box_of_points
from sightline.simulation.packaged import PACKAGED_FRAMES
from tests.ops.clouds import street

CLASSES = (CAR, PEDESTRIAN, CYCLIST)


def level(num_centers, radius_m, width):
    scale = NeighbourhoodConfig(radius_m=radius_m, num_neighbours=16, widths=(width, width))
    return AbstractionConfig(num_centers=num_centers, scales=(scale,))


SMALL = ProposalNetworkConfig(
    classes=CLASSES,
    backbone=PointBackboneConfig(
        in_channels=1,
        levels=(level(256, 0.7, 24), level(64, 2.0, 48)),
        propagation_widths=((48,), (48,)),
    ),
    head_width=48,
    dropout=0.0,
)


def run(network, points, features):
    return network(points, features, **network.backbone.find(points))


def test_the_defaults_are_the_published_sizes():
    network = ProposalNetwork(ProposalNetworkConfig()).eval()
    output = run(network, street(0, 300), torch.zeros(1, 300, 0))
    assert output.features.shape == (1, 300, 128)
    assert output.class_logits.shape == (1, 300, 1)
    assert output.box_values.shape == (1, 300, 76)


def test_what_a_network_is_sure_of_is_told_as_it_was_encoded():
    points = torch.tensor([[[10.0, 5.0, -1.0], [20.0, -3.0, -0.5]]])
    car, walker = [10.9, 4.4, -0.8, 4.1, 1.7, 1.6, 2.0], [20.1, -3.1, -0.6, 0.9, 0.7, 1.8, 0.0]
    boxes = torch.tensor([[car, walker]])
    means = torch.tensor([CAR.mean_size_m, PEDESTRIAN.mean_size_m])
    code = encode_boxes(boxes[0], points[0], means, SMALL.coding)
    values = torch.zeros(2, SMALL.coding.channels)
    exact = split_prediction(values, SMALL.coding)  # views
    for scores, residuals, chosen, residual in (
        (exact.x_bins, exact.x_residuals, code.x_bin, code.x_residual),
        (exact.y_bins, exact.y_residuals, code.y_bin, code.y_residual),
        (exact.heading_bins, exact.heading_residuals, code.heading_bin, code.heading_residual),
    ):
        scores.scatter_(1, chosen[:, None], 99.0)
        residuals.scatter_(1, chosen[:, None], residual[:, None])
    exact.z_offset[:, 0], exact.size_residual[:] = code.z_offset, code.size_residual
    logits = torch.tensor([[[3.0, -2.0, 0.0], [-5.0, -1.0, -4.0]]])
    output = ProposalNetworkOutput(torch.zeros(1, 2, 4), logits, values[None])
    (decoded,) = decode_points(output, points, SMALL)
    torch.testing.assert_close(decoded.boxes, boxes[0])
    assert decoded.classes.tolist() == [0, 1]
    assert decoded.scores.tolist() == pytest.approx([0.952574, 0.268941], abs=1e-5)
    loss = proposal_loss(output, points, boxes, decoded.classes[None], SMALL, ProposalLossConfig())
    assert loss.center.item() + loss.heading.item() + loss.size.item() == pytest.approx(0, abs=1e-5)
    assert loss.total.item() == pytest.approx(loss.segmentation.item(), abs=1e-5)
    on_each = torch.tensor([[0, 1]])
    assert loss.segmentation.item() == pytest.approx(
        focal_loss(logits, on_each, FocalLossConfig()).item()
    )


def test_a_frame_without_objects_teaches_that_points_lie_on_nothing():
    torch.manual_seed(0)
    network, points = ProposalNetwork(SMALL), street(0, 300)
    output = run(network, points, torch.rand(1, 300, 1))
    nothing = torch.zeros(1, 2, 7), torch.zeros(1, 2, dtype=torch.int64)
    loss = proposal_loss(output, points, *nothing, SMALL, ProposalLossConfig())
    loss.total.backward()
    assert loss.total.item() == loss.segmentation.item() > 0
    assert torch.equal(network.box_head[-1].weight.grad, torch.zeros(76, 48))


def test_before_training_hardly_a_point_is_on_an_object():
    torch.manual_seed(0)
    network = ProposalNetwork(SMALL).eval()
    output = run(network, street(0, 500), torch.rand(1, 500, 1))
    assert 0.002 < output.class_logits.sigmoid().mean().item() < 0.05


def test_a_small_network_learns_the_boxes_of_a_street_by_heart():
    torch.manual_seed(0)
    points, boxes, classes = frame()
    assert set(classes[0].tolist()) == {0, 1, 2}
    network = ProposalNetwork(SMALL)
    optimizer = torch.optim.Adam(network.parameters())
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 1e-2, total_steps=200)
    for _ in range(200):
        output = run(network, points[..., :3], points[..., 3:])
        loss = proposal_loss(
            output, points[..., :3], boxes, classes, SMALL, ProposalLossConfig()
        ).total
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    output = run(network, points[..., :3], points[..., 3:])
    (decoded,) = decode_points(output, points[..., :3], SMALL)
    decoded_boxes = decoded.boxes.detach()
    chosen = choose_proposals(decoded_boxes, decoded.scores.detach(), ProposalConfig())
    proposals = decoded_boxes[chosen]
    assert find_recalled(proposals, boxes[0]).all()


def frame():
    """Some points of the first packaged street, up to 150 of each road user, and their boxes."""
    sample = KittiObjectDataset(PACKAGED_FRAMES, parts=("points", "objects"))[0]
    names = [entry.name for entry in CLASSES]
    is_selected = torch.tensor([name in names for name in sample.objects.class_names])
    labels = sample.objects.select(is_selected)
    classes = torch.tensor([names.index(name) for name in labels.class_names])
    boxes = labels.boxes3d.tensor.float()[None]
    box = first_box_of_points(sample.points[None, :, :3], boxes)[0]
    kept = []
    for k in range(-1, len(labels)):  # of what lies on nothing, and of each object
        places = (box == k).nonzero()[:, 0]
        kept.append(places[:: len(places) // 150 + 1] if k >= 0 else places[::50])
    return sample.points[torch.cat(kept)][None], boxes, classes[None]


def test_settings_out_of_range_are_refused():
    with pytest.raises(ValueError, match="classes must hold one or more different ones"):
        ProposalNetworkConfig(classes=(CAR, CAR))
    with pytest.raises(ValueError, match="head_width must be at least 1, got 0"):
        ProposalNetworkConfig(head_width=0)
    with pytest.raises(ValueError, match="dropout must be from 0 to below 1, got 1"):
        ProposalNetworkConfig(dropout=1.0)

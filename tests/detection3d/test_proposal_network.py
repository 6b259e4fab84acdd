"""The first stage: its sizes, and that a small one learns a street by heart."""

import pytest
import torch

from sightline.data.kitti_object import KittiObjectDataset
from sightline.detection3d.box_coding import (
    BoxCodingConfig,
    decode_boxes,
    encode_boxes,
    likeliest_code,
    split_prediction,
)
from sightline.detection3d.classes import CAR, CYCLIST, PEDESTRIAN
from sightline.detection3d.config import (
    AbstractionConfig,
    NeighbourhoodConfig,
    PointBackboneConfig,
)
from sightline.detection3d.foreground import focal_loss, point_targets
from sightline.detection3d.proposal_loss import box_code_loss
from sightline.detection3d.proposal_network import ProposalNetwork, ProposalNetworkConfig
from sightline.detection3d.proposal_recall import find_recalled
from sightline.detection3d.proposals import choose_proposals
from sightline.ops.group_points import group_points
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


def test_the_defaults_are_the_published_sizes():
    network = ProposalNetwork(ProposalNetworkConfig()).eval()
    output = network(street(0, 300), torch.zeros(1, 300, 0))
    assert output.features.shape == (1, 300, 128)
    assert output.class_logits.shape == (1, 300, 1)
    assert output.box_values.shape == (1, 300, 76)


def test_before_training_hardly_a_point_is_on_an_object():
    torch.manual_seed(0)
    network = ProposalNetwork(SMALL).eval()
    output = network(street(0, 500), torch.rand(1, 500, 1))
    assert 0.002 < output.class_logits.sigmoid().mean().item() < 0.05


def test_a_small_network_learns_the_boxes_of_a_street_by_heart():
    torch.manual_seed(0)
    points, boxes, classes = frame()
    targets = point_targets(points[..., :3], boxes, classes)
    on_object = targets.point_class >= 0
    assert set(classes[0].tolist()) == {0, 1, 2}
    means = torch.tensor([entry.mean_size_m for entry in CLASSES])[targets.point_class[on_object]]
    coding, xyz = BoxCodingConfig(), points[..., :3][on_object]
    code = encode_boxes(
        group_points(boxes, targets.box.clamp(min=0))[on_object], xyz, means, coding
    )
    network = ProposalNetwork(SMALL)
    optimizer = torch.optim.Adam(network.parameters())
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 1e-2, total_steps=200)
    for _ in range(200):
        output = network(points[..., :3], points[..., 3:])
        prediction = split_prediction(output.box_values[on_object], coding)
        loss = focal_loss(output.class_logits, targets.point_class)
        loss = loss + box_code_loss(prediction, code).total
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    output = network(points[..., :3], points[..., 3:])
    scores, found = output.class_logits[0].detach().max(dim=1)
    sizes = torch.tensor([entry.mean_size_m for entry in CLASSES])[found]
    told = likeliest_code(split_prediction(output.box_values[0].detach(), coding))
    decoded = decode_boxes(told, points[0, :, :3], sizes, coding)
    proposals = decoded[choose_proposals(decoded, scores)]
    assert find_recalled(proposals, boxes[0]).all()


def frame():
    """Some points of the first packaged street, up to 150 of each road user, and their boxes."""
    sample = KittiObjectDataset(PACKAGED_FRAMES, parts=("points", "objects"))[0]
    names = [entry.name for entry in CLASSES]
    wanted = torch.tensor([name in names for name in sample.objects.class_names])
    labels = sample.objects.select(wanted)
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

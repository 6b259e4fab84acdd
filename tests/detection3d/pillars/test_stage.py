"""The first stage's network: its size, and that it learns."""

import pytest
import torch

from sightline.data.datasets.kitti_object import KittiObjectDataset
from sightline.detection3d.classes import CAR, CYCLIST, PEDESTRIAN
from sightline.detection3d.pillars.boxes import find_boxes
from sightline.detection3d.pillars.config import (
    PillarDetectionConfig,
    PillarGridConfig,
    PillarLossConfig,
    PillarNetworkConfig,
    PillarTargetsConfig,
)
from sightline.detection3d.pillars.stage import PillarNetwork, pillar_features
from sightline.detection3d.pillars.training import pillar_loss, pillar_targets
from sightline.detection3d.sweeps import SweepConfig, SweepTruthConfig, make_truth
from sightline.ops.rotated_iou import pairwise_iou_3d
from sightline.simulation.packaged import PACKAGED_FRAMES

GRID = PillarGridConfig(x_m=(0.0, 32.0), y_m=(-16.0, 16.0), cell_m=0.2)
SMALL = PillarNetworkConfig(grid=GRID, channels=(16, 24, 32), blocks=(1, 0, 1), head_channels=24)


def test_the_default_is_of_the_size_that_was_chosen():
    network = PillarNetwork(PillarNetworkConfig())
    assert sum(weight.numel() for weight in network.parameters()) == 643_876
    output = network(torch.zeros(1, 16, 24, 40))
    assert output.heat_logits.shape == (1, 3, 12, 20)
    assert output.center_values.shape == (1, 3, 11, 12, 20)


def test_the_first_stage_learns_two_simulated_frames_by_heart_in_channels_last_and_bf16():
    torch.manual_seed(0)
    frames = KittiObjectDataset(PACKAGED_FRAMES, parts=("points", "objects"))
    names, wide = ("Car", "Pedestrian", "Cyclist"), SweepConfig(highest_m=(200.0, 90.0, 20.0))
    config = SweepTruthConfig(min_points=5)
    scenes = [make_truth(each.objects, each.points, names, wide, config) for each in frames]
    features = [pillar_features(frame.points, GRID) for frame in frames]
    pillars = torch.stack(features).contiguous(memory_format=torch.channels_last)
    targets = pillar_targets(scenes, 3, GRID, PillarTargetsConfig())
    network = PillarNetwork(SMALL).to(memory_format=torch.channels_last)
    optimizer = torch.optim.Adam(network.parameters(), lr=5e-3)
    for _ in range(80):
        with torch.autocast("cpu", torch.bfloat16):
            output = network(pillars)
        loss = pillar_loss(output, targets, SMALL, PillarLossConfig()).total
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 10.0)
        optimizer.step()
    with torch.no_grad():
        output = network(pillars)  # as trained: so few steps leave no running means
    for sweep, scene in enumerate(scenes):
        is_inside = (scene.boxes[:, 0] < 32) & (scene.boxes[:, 1].abs() < 16)
        truths, classes = scene.boxes[is_inside], scene.classes[is_inside]
        found = find_boxes(output, sweep, SMALL, PillarDetectionConfig(min_heat=0.3))
        iou = pairwise_iou_3d(truths, found.boxes.double())
        best = iou.argmax(dim=1)
        assert len(found.boxes) == len(truths) >= 2
        assert torch.equal(found.classes[best], classes)
        assert iou.amax(dim=1).min() > 0.5
        assert (found.boxes[best, 6] - truths[:, 6]).cos().min() > 0.9


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"classes": ()}, "classes must hold one or more different ones"),
        ({"classes": (CAR, CYCLIST, PEDESTRIAN, CAR)}, "classes must hold one or more different"),
        ({"channels": (16, 0, 16)}, "channels must be at least 1, got"),
        ({"blocks": (1, -1, 1)}, "blocks must be at least 0, got"),
    ],
)
def test_settings_out_of_range_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        PillarNetworkConfig(**wrong)

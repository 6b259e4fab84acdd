"""Which proposals the second stage trains on."""

import math

import numpy as np
import pytest
import torch

from sightline.detection3d.classes import CAR, CYCLIST, PEDESTRIAN
from sightline.detection3d.pillars.region_config import RegionExamplesConfig
from sightline.detection3d.pillars.region_training import region_examples
from sightline.detection3d.stages import Proposed
from sightline.geometry.boxes3d import Boxes3D
from tests.detection3d.scenes import scene_of, sweep_of

CLASSES = (CAR, PEDESTRIAN, CYCLIST)
BOXES = [[8.0, 2.0, -0.9, 4.0, 1.6, 1.5, 0.4], [12.0, -4.0, -0.8, 0.8, 0.6, 1.8, 1.0]]
POINTS = sweep_of(BOXES)[:, :3]
MANY = RegionExamplesConfig(num_objects=4000, num_background=0)


def draw(scene, config, found=None, seed=0):
    rng = np.random.default_rng(seed)
    return region_examples(scene, POINTS, CLASSES, rng, config, found=found)


def test_truths_are_moved_by_as_much_as_is_asked_for():
    drawn = draw(scene_of(BOXES, [0, 1]), MANY)
    assert drawn.is_object.all()
    assert torch.equal(drawn.truths, torch.tensor(BOXES, dtype=torch.float64)[drawn.classes])
    spread = math.sqrt(0.7 + 0.3 * 4)  # three in ten twice as far
    for k, (length, width, height) in enumerate([(4.0, 1.6, 1.5), (0.8, 0.6, 1.8)]):
        mine = drawn.classes == k
        move = (drawn.proposals - drawn.truths)[mine]
        across = max(0.07 * math.sqrt(length * width), 0.08)
        measured = move[:, :3].std(dim=0) / spread
        assert measured.tolist() == pytest.approx([across, across, 0.065 * height], rel=0.1)
        logs = (drawn.proposals / drawn.truths)[mine, 3:6].log().std(dim=0) / spread
        assert logs.tolist() == pytest.approx([0.06, 0.04, 0.05], rel=0.1)
        turn = move[:, 6].cos()
        assert (turn < 0).double().mean().item() == pytest.approx(0.15, abs=0.03)
        assert (2 * move[:, 6]).sin().std().item() == pytest.approx(0.12 * spread, rel=0.1)


def test_the_same_seed_draws_the_same():
    scene = scene_of(BOXES, [0, 1])
    for one, other in zip(
        draw(scene, RegionExamplesConfig()), draw(scene, RegionExamplesConfig()), strict=True
    ):
        assert torch.equal(one, other)
    other = draw(scene, RegionExamplesConfig(), seed=1)
    assert not torch.equal(other.proposals[:24], draw(scene, RegionExamplesConfig()).proposals[:24])


def test_background_has_a_class_s_mean_sizes_holds_a_point_and_is_clear_of_all_objects():
    scene = scene_of(BOXES, [0, 1], ignored=1)
    drawn = draw(scene, RegionExamplesConfig(num_objects=0, num_background=300))
    assert 150 < len(drawn.proposals) <= 300
    assert not drawn.is_object.any()
    means = torch.tensor([entry.mean_size_m for entry in CLASSES])[drawn.classes]
    torch.testing.assert_close(drawn.proposals[:, 3:6].float(), means)
    inside = Boxes3D(drawn.proposals).enlarge(1e-6).contain(POINTS.double())
    assert inside.any(dim=1).all()
    distance = (drawn.proposals[:, None, :2] - torch.tensor(BOXES)[:, :2]).norm(dim=2)
    assert (distance[:, 1] > 0.3).all()  # that one is ignored, and yet no background


def test_what_the_first_stage_found_is_on_an_object_or_off_it_or_left_out():
    near, half_on = list(BOXES[0]), list(BOXES[0])
    near[0] += 0.3
    half_on[0] += 3.2
    wrong_class, away = list(BOXES[1]), [4.0, -6, -0.9, 4, 1.6, 1.5, 0.0]
    proposals = torch.tensor([near, half_on, wrong_class, away])
    found = Proposed(proposals, torch.tensor([0, 0, 2, 0]), torch.ones(4))
    config = RegionExamplesConfig(num_objects=0, num_background=0, proposal_factor=0.0)
    drawn = draw(scene_of(BOXES, [0, 1]), config, found)
    order = drawn.proposals[:, 0].argsort()
    assert drawn.proposals[order, 0].tolist() == pytest.approx([4.0, 8.3, 12.0])
    assert drawn.is_object[order].tolist() == [False, True, False]
    assert drawn.truths[order[1]].tolist() == pytest.approx(BOXES[0])
    few = RegionExamplesConfig(num_objects=0, num_background=0, num_proposals=1)
    assert len(draw(scene_of(BOXES, [0, 1]), few, found).proposals) == 1


def test_what_the_first_stage_found_on_ignored_objects_is_left_out():
    found = Proposed(torch.tensor([BOXES[1]]), torch.tensor([1]), torch.ones(1))
    config = RegionExamplesConfig(num_objects=0, num_background=0)
    scene = scene_of(BOXES, [0, 1], ignored=1)
    assert len(draw(scene, config, found).proposals) == 0
    scene.ignored_classes[0, 1] = False  # for cars and cyclists alone
    assert draw(scene, config, found).is_object.tolist() == [False]


def test_a_frame_without_objects_gives_background_alone_and_one_without_points_nothing():
    empty = scene_of([], [])
    found = Proposed(torch.tensor([BOXES[0]]), torch.tensor([0]), torch.ones(1))
    drawn = draw(empty, RegionExamplesConfig(), found)
    assert len(drawn.proposals) == 9
    assert not drawn.is_object.any()
    rng = np.random.default_rng(0)
    assert (
        len(region_examples(empty, POINTS[:0], CLASSES, rng, RegionExamplesConfig()).proposals) == 0
    )


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"num_objects": -1}, "num_objects must be at least 0, got -1"),
        ({"yaw_rad": float("nan")}, "yaw_rad must be finite and not negative, got nan"),
        ({"log_sizes": (0.1, 0.1, -0.1)}, "log_sizes must be finite and not negative, got"),
        ({"doubled_share": 1.1}, "doubled_share must be from 0 to 1, got 1.1"),
        ({"min_iou": 0.01}, "max_background_iou and min_iou must rise from 0 to 1"),
    ],
)
def test_settings_out_of_range_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        RegionExamplesConfig(**wrong)

"""Ground truth of a sweep from labels."""

import pytest
import torch

from sightline.detection3d.sweeps import SweepConfig, SweepTruthConfig, make_truth
from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.boxes3d import Boxes3D
from sightline.structures.labels import ObjectLabels

NAMES = ("Car", "Van", "Pedestrian", "Cyclist", "DontCare", "Car", "Person_sitting", "DontCare")
NUM_POINTS = (9, 9, 5, 9, 0, 4, 9, 0)

SEEN = SweepConfig(lowest_m=(-1.0, -40.0, -3.0), highest_m=(70.4, 40.0, 1.0))


def labels():
    boxes = torch.zeros(len(NAMES), 7, dtype=torch.float64)
    boxes[:, 0] = 5 * torch.arange(len(NAMES))
    boxes[:, 3:6] = 2
    boxes[4] = 0  # a DontCare of the image alone
    return ObjectLabels(
        class_names=NAMES,
        boxes2d=Boxes2D(torch.zeros(len(NAMES), 4, dtype=torch.float64)),
        boxes3d=Boxes3D(boxes),
        truncation=torch.zeros(len(NAMES), dtype=torch.float64),
        occlusion=torch.zeros(len(NAMES), dtype=torch.int64),
        alpha=torch.zeros(len(NAMES), dtype=torch.float64),
    )


def points():
    inside = [
        [5.0 * k, 0.1, 0.1, n / 9] for k, count in enumerate(NUM_POINTS) for n in range(count)
    ]
    return torch.tensor([*inside, [99.0, 99.0, 0.0, 0.0]])


def test_few_points_and_alike_classes_are_ignored_for_their_class_and_dontcare_for_all():
    scene = make_truth(
        labels(), points(), ("Pedestrian", "Car"), SEEN, SweepTruthConfig(min_points=5)
    )
    assert scene.boxes[:, 0].tolist() == [0, 10]
    assert scene.classes.tolist() == [1, 0]
    assert scene.ignored_boxes[:, 0].tolist() == [5, 25, 30, 35]
    assert scene.ignored_classes.tolist() == [
        [False, True], [False, True], [True, False], [True, True],
    ]  # fmt: skip


def test_a_point_that_fills_up_a_sparse_sweep_several_times_counts_once():
    config = SweepTruthConfig(min_points=5)
    once = make_truth(labels(), points(), ("Car",), SEEN, config)
    repeated = make_truth(labels(), points().repeat(3, 1), ("Car",), SEEN, config)
    assert repeated.boxes[:, 0].tolist() == once.boxes[:, 0].tolist() == [0]


def test_names_and_points_that_shall_not_be_ignored_are_not():
    config = SweepTruthConfig(ignored_names=(), min_points=0)
    scene = make_truth(labels(), points()[:0], ("Car",), SEEN, config)
    assert scene.boxes[:, 0].tolist() == [0, 25]
    assert scene.ignored_boxes[:, 0].tolist() == [35]
    assert scene.ignored_classes.shape == (1, 1)


def test_a_frame_without_objects_has_none():
    nothing = labels().select(torch.zeros(len(NAMES), dtype=torch.bool))
    scene = make_truth(nothing, points(), ("Car", "Pedestrian"), SEEN)
    assert scene.boxes.shape == scene.ignored_boxes.shape == (0, 7)
    assert scene.ignored_classes.shape == (0, 2)


def test_settings_out_of_range_are_refused():
    with pytest.raises(ValueError, match=r"ignored_names may hold Van, .*, got Tram"):
        SweepTruthConfig(ignored_names=("Tram",))
    with pytest.raises(ValueError, match="min_points must be at least 0, got -1"):
        SweepTruthConfig(min_points=-1)

import dataclasses

import pytest
import torch

from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.boxes3d import Boxes3D
from sightline.structures.predictions import Detections2D, Detections3D, Perception

SCORES = torch.tensor([0.9, 0.3, 0.5])


def detections2d():
    boxes = Boxes2D(torch.tensor([[i, 0.0, i + 10.0, 5.0] for i in range(3)]))
    return Detections2D(class_names=("Car", "Cyclist", "Car"), boxes=boxes, scores=SCORES)


def detections3d():
    boxes = Boxes3D(torch.tensor([[10.0 + i, 0.0, 0.0, 4.0, 1.8, 1.5, 0.0] for i in range(3)]))
    return Detections3D(class_names=("Car", "Cyclist", "Car"), boxes=boxes, scores=SCORES)


@pytest.mark.parametrize("make", [detections2d, detections3d])
def test_detections_are_filtered_by_score_in_their_order(make):
    kept = make().filter_by_score(0.5)
    assert kept.class_names == ("Car", "Car")
    assert torch.equal(kept.scores, SCORES[[0, 2]])
    assert torch.equal(kept.boxes.tensor, make().boxes.tensor[[0, 2]])


@pytest.mark.parametrize("make", [detections2d, detections3d])
def test_a_threshold_in_percent_is_warned_of_and_none_is_refused(make):
    with pytest.warns(UserWarning, match="min_score is 30, but the scores are from 0 to 1"):
        assert len(make().filter_by_score(30.0).scores) == 0
    with pytest.raises(ValueError, match="min_score must be a number, got nan"):
        make().filter_by_score(float("nan"))
    any_scale = dataclasses.replace(make(), scores=10 * SCORES)  # 9, 3, 5
    assert len(any_scale.filter_by_score(4.0).scores) == 2
    assert len(any_scale.filter_by_score(30.0).scores) == 0


def test_a_perception_is_filtered_in_both_tasks():
    kept = Perception(detections2d=detections2d(), detections3d=detections3d()).filter_by_score(0.6)
    assert len(kept.detections2d.scores) == len(kept.detections3d.scores) == 1


@pytest.mark.parametrize("make", [detections2d, detections3d])
def test_the_earlier_name_of_the_filter_works_and_says_the_new_one(make):
    with pytest.warns(DeprecationWarning, match="surer_than is now filter_by_score"):
        assert len(make().surer_than(0.5).scores) == 2

from dataclasses import replace

import numpy as np
import pytest
import torch

from sightline.detection3d.pictures import DRAWN_SCORE, LABELLED, PROPOSED, prediction_picture
from sightline.detection3d.predictor import Detection3DPredictor
from sightline.geometry.boxes3d import Boxes3D
from sightline.structures.predictions import Detections3D
from sightline.visualization.colors import class_color
from tests.detection3d.frames import COMPACT, simulated_frames, write_network

CAR = [12.0, 1.0, -0.9, 4.0, 1.7, 1.5, 0.3]
NOTHING = Detections3D(class_names=(), boxes=Boxes3D(torch.zeros(0, 7)), scores=torch.zeros(0))


def detections(score):
    return Detections3D(
        class_names=("Car",), boxes=Boxes3D(torch.tensor([CAR])), scores=torch.tensor([score])
    )


def pixels_of(picture, color):
    return int((np.abs(picture.astype(int) - color).max(axis=2) <= 12).sum())


@pytest.fixture(scope="module")
def sample():
    return simulated_frames()[0]


def test_proposals_and_detections_are_told_apart_and_both_seen_from_above(sample):
    bare = replace(sample, objects=None, points=None, image=None)
    empty = prediction_picture("frame", bare, NOTHING, NOTHING)
    proposed = prediction_picture("frame", bare, detections(0.9), NOTHING)
    found = prediction_picture("frame", bare, NOTHING, detections(0.9))
    seen_px, half = 900, empty.shape[0] // 2
    for part in ((slice(None, half), slice(None, seen_px)), (slice(None), slice(seen_px, None))):
        assert pixels_of(proposed[part], PROPOSED) > pixels_of(empty[part], PROPOSED) + 50
    for part in ((slice(half, None), slice(None, seen_px)), (slice(None), slice(seen_px, None))):
        assert pixels_of(found[part], class_color("Car")) > 50
    assert pixels_of(found[:half, :seen_px], class_color("Car")) == 0
    assert not np.array_equal(prediction_picture("other", bare, NOTHING, NOTHING), empty)


def test_unsure_boxes_are_not_drawn_and_labels_are_white(sample):
    low_scored = prediction_picture("frame", sample, detections(0.29), detections(0.29))
    without = prediction_picture("frame", sample, NOTHING, NOTHING)
    assert np.array_equal(low_scored, without)
    unlabelled = prediction_picture("frame", replace(sample, objects=None), NOTHING, NOTHING)
    assert pixels_of(without, LABELLED) > pixels_of(unlabelled, LABELLED) + 50
    assert len(detections(0.3).filter_by_score(DRAWN_SCORE).scores) == 1


def test_the_predictor_gives_what_both_stages_make(sample, tmp_path):
    write_network(tmp_path / "tiny.safetensors", COMPACT)
    predictor = Detection3DPredictor.load(tmp_path / "tiny.safetensors")
    proposed, found = predictor.both_stages(sample)
    assert torch.equal(found.boxes.tensor, predictor(sample).boxes.tensor)
    assert len(proposed.scores) >= len(found.scores) > 0
    assert not torch.equal(proposed.scores[: len(found.scores)], found.scores)

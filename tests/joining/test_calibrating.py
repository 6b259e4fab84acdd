import dataclasses

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.boxes3d import Boxes3D
from sightline.joining.calibrating import calibrate_models, fit_map
from sightline.joining.config import JoinConfig
from sightline.joining.fitting import FitFrame
from sightline.joining.join import join_detections
from sightline.joining.models import ScoreMap, identity_maps, read_models
from sightline.structures.labels import ObjectLabels
from tests.joining.scenes import detections2d, detections3d, make_sample, own_score_models

SEEN = (300.0, 150.0, 380.0, 220.0)
BESIDE = (800.0, 150.0, 880.0, 220.0)


@given(
    scores=st.lists(st.floats(0, 1), min_size=2, max_size=20),
    low=st.floats(0.05, 5),
    high=st.floats(0.05, 5),
    bias=st.floats(-3, 3),
)
def test_a_calibrated_score_is_a_probability_and_the_order_stays(scores, low, high, bias):
    found = ScoreMap(low=low, high=high, bias=bias)(np.sort(np.array(scores)))
    assert ((found >= 0) & (found <= 1)).all()
    assert (np.diff(found) >= 0).all()


def test_a_map_is_beta_calibration():
    score = 0.3
    odds = score**2 / (1 - score) ** 0.5 * np.exp(0.25)
    found = ScoreMap(low=2.0, high=0.5, bias=0.25)(np.array([score]))
    assert found[0] == pytest.approx(odds / (1 + odds))
    assert ScoreMap()(np.array([0.0, 0.3, 1.0])) == pytest.approx([0, 0.3, 1], abs=1e-8)


def test_a_map_that_would_turn_the_order_is_refused():
    with pytest.raises(
        ValueError, match="a calibration must have finite numbers and positive slopes"
    ):
        ScoreMap(low=-0.1)


def test_a_fit_finds_the_map_that_scores_need():
    scores = np.linspace(0.05, 0.95, 2000)
    true = ScoreMap(low=2.0, high=1.2, bias=0.5)(scores)
    found = fit_map(scores, true)
    assert found(scores) == pytest.approx(true, abs=0.01)
    assert fit_map(np.array([0.01]), np.array([1.0])) == ScoreMap()


def labelled(points=((20.0, 0.0, -1.7, 0.0),)):
    labels = ObjectLabels(
        class_names=("Car",),
        boxes2d=Boxes2D(torch.tensor([SEEN]).double()),
        boxes3d=Boxes3D(torch.zeros(1, 7).double()),
        truncation=torch.zeros(1).double(),
        occlusion=torch.zeros(1).long(),
        alpha=torch.zeros(1).double(),
    )
    return dataclasses.replace(make_sample(points), objects=labels)


def test_a_repeated_object_is_wrong_and_only_the_class_and_state_that_were_seen_change():
    near = tuple(each + 1.0 for each in BESIDE)
    found2d = detections2d(("Car", 0.75, SEEN), ("Car", 0.5, BESIDE), ("Car", 0.25, near))
    frames = [FitFrame(sample=labelled(), found2d=found2d, found3d=None)] * 50
    models = calibrate_models(own_score_models(), frames)
    assert models.calibrators["alone"] == identity_maps()["alone"]
    assert models.calibrators["image"]["Cyclist"] == ScoreMap()
    given, config = own_score_models(), JoinConfig(calibrate=False)
    before = join_detections(labelled(), found2d, None, given, config)
    after = join_detections(labelled(), found2d, None, models)
    assert after.image_support.tolist() == before.image_support.tolist()
    assert after.scores[0] > before.scores[0]
    assert (after.scores[1:] < 0.2).all()


def test_shipped_calibrators_keep_the_objects_and_the_order_of_each_class():
    car = ("Car", 0.5, 20.0, 1.0, -0.95, 4.0, 1.8, 1.5, 0.0)
    found3d = detections3d(car, ("Car", 0.2, 40.0, *car[3:]), ("Pedestrian", 0.4, 12.0, *car[3:]))
    found2d = detections2d(("Car", 0.3, SEEN), ("Car", 0.9, BESIDE))
    sample, models = make_sample([20.0, 1.0, -1.0, 0.0]), read_models()
    plain = join_detections(sample, found2d, found3d, models, JoinConfig(calibrate=False))
    found = join_detections(sample, found2d, found3d, models)
    assert found.scores.tolist() == sorted(found.scores.tolist(), reverse=True)
    assert not torch.allclose(found.scores.sort().values, plain.scores.sort().values)
    for name in ("Car", "Pedestrian"):
        supports = [
            [
                (each.image_support[index].item(), each.lidar_support[index].item())
                for index, one in enumerate(each.class_names)
                if one == name
            ]
            for each in (plain, found)
        ]
        assert supports[0] == supports[1]

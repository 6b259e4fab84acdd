import dataclasses
import math

import numpy as np
import pytest
import torch
from hypothesis import given

from sightline.joining.config import JoinConfig
from sightline.joining.evidence import gather_evidence
from sightline.joining.join import join_detections, match
from sightline.joining.models import read_models
from sightline.structures.objects import Objects
from tests.joining.scenes import (
    detections2d,
    detections3d,
    flat_scene,
    make_sample,
    own_score_models,
)
from tests.joining.test_evidence import boxes
from tests.reference import joining as reference

MODELS = own_score_models()
CAR = ("Car", 0.5, 20.0, 1.0, -0.95, 4.0, 1.8, 1.5, 0.0)
BEHIND = ("Car", 0.4, -20.0, 1.0, -0.95, 4.0, 1.8, 1.5, 0.0)
CAR_IN_IMAGE = (542.5, 191.0, 616.5, 252.5)
"""Projection of `CAR` [px], nearly."""
BY_DEFAULT = JoinConfig()
ALL_OFF = JoinConfig(associate=False, rescore=False, mix_boxes=False, lift=False)


def join(found2d, found3d, config=BY_DEFAULT, **fields) -> Objects:
    return join_detections(make_sample(**fields), found2d, found3d, MODELS, config)


@given(sweep=boxes, image=boxes)
def test_boxes_are_matched_as_loops_match_them(sweep, image):
    scene = flat_scene(sweep, image)
    partners = match(gather_evidence(scene), scene.sweep.scores, scene.image.scores, JoinConfig())
    assert partners.tolist() == reference.match(sweep, image, 0.5)


def test_matched_boxes_are_one_object_with_a_mixed_box_and_both_supports():
    alone = join(None, detections3d(CAR))
    found = join(detections2d(("Car", 0.25, CAR_IN_IMAGE)), detections3d(CAR))
    assert len(found) == len(alone) == 1
    assert found.origins == ("measured",)
    assert found.scores[0].item() == pytest.approx(1 - (1 - 0.5 * 0.5) * 0.75)
    assert found.scores3d[0].item() == pytest.approx(0.5)
    assert found.image_support[0].item() == pytest.approx(0.25)
    assert found.lidar_support[0].item() == pytest.approx(0.5)
    projected = alone.boxes2d.tensor[0]
    expected = 0.75 * projected + 0.25 * torch.tensor(CAR_IN_IMAGE)
    torch.testing.assert_close(found.boxes2d.tensor[0], expected.double(), rtol=0, atol=1e-3)


def test_a_sure_image_box_is_matched_before_a_doubtful_one_that_fits_better():
    narrower = (545.0, 191.0, 600.0, 252.5)
    found = join(
        detections2d(("Car", 0.25, narrower), ("Car", 0.05, CAR_IN_IMAGE)), detections3d(CAR)
    )
    assert found.origins == ("measured",)
    assert found.image_support[0].item() == pytest.approx(0.25)


def test_boxes_of_two_classes_stay_two_objects():
    found = join(detections2d(("Cyclist", 0.25, CAR_IN_IMAGE)), detections3d(CAR))
    assert sorted(found.class_names) == ["Car", "Cyclist"]


def test_with_all_stages_off_each_detection_is_an_object_with_its_own_score():
    seen = ("Car", 0.25, CAR_IN_IMAGE)
    found = join(detections2d(seen, seen), detections3d(CAR, BEHIND), ALL_OFF)
    assert found.origins == ("measured", "measured", "none", "none")
    assert found.scores.tolist() == [pytest.approx(score) for score in (0.5, 0.4, 0.25, 0.25)]


def test_an_object_without_an_image_box_counts_half_where_the_image_detector_ran():
    for found2d, expected in ((detections2d(), 0.25), (None, 0.5)):
        found = join(found2d, detections3d(CAR))
        assert found.scores[0].item() == pytest.approx(expected)
        assert found.scores3d[0].item() == pytest.approx(0.5)


def test_an_object_outside_the_image_has_the_score_of_its_3d_box():
    calibrated = dataclasses.replace(MODELS, calibrators=read_models().calibrators)
    sample, found3d = make_sample(points=[(20.0, 1.0, -1.0, 0.0)]), detections3d(BEHIND)
    found = join_detections(sample, detections2d(), found3d, calibrated)
    (expected,) = read_models().calibrators["image_3d"]["Car"](np.array([0.4]))
    assert found.scores[0] == found.scores3d[0]
    assert found.scores[0].item() == pytest.approx(expected)


def test_an_object_outside_the_image_keeps_its_score_and_has_no_image_box():
    found = join(detections2d(), detections3d(BEHIND))
    assert found.has_box2d.tolist() == [False]
    assert found.scores[0].item() == pytest.approx(0.4)
    assert found.to_json()[0]["box_px"] is None


def test_without_lidar_an_image_box_is_lifted_and_a_doubtful_one_has_no_3d_box():
    left = ("Car", 0.05, (100.0, 180.0, 200.0, 250.0))
    found = join(detections2d(("Car", 0.25, CAR_IN_IMAGE), left), None)
    assert found.origins == ("lifted", "none")
    assert found.has_box3d.tolist() == [True, False]
    assert found.scores3d[1].item() == 0
    assert found.boxes3d.tensor[0, 0].item() == pytest.approx(20, rel=0.08)


def test_without_lidar_the_scores_keep_the_order_of_the_detector():
    models = read_models()
    given = [
        ("Car", 0.1 * i, (100.0 * i, 150.0 + 9 * i, 90 + 100.0 * i, 250.0)) for i in range(1, 9)
    ]
    found = join_detections(make_sample(), detections2d(*given), None, models)
    assert found.image_support.tolist() == sorted(found.image_support.tolist(), reverse=True)
    beside = join_detections(make_sample([9.0, 0, -1.7, 0]), detections2d(*given), None, models)
    assert not torch.allclose(found.scores.sort().values, beside.scores.sort().values)


def test_a_repeated_image_box_is_left_out_but_no_measured_one():
    near = tuple(each + 2 for each in CAR_IN_IMAGE)
    found = join(
        detections2d(("Car", 0.25, CAR_IN_IMAGE), ("Car", 0.125, near)), detections3d(CAR, CAR)
    )
    assert found.origins == ("measured", "measured")


def test_no_detections_are_no_objects():
    assert len(join(detections2d(), detections3d())) == 0
    assert len(join(None, None)) == 0


def test_boxes_are_in_the_frame_of_a_turned_lidar():
    quarter = torch.tensor(
        [[0.0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], dtype=torch.float64
    )
    turned = ("Car", 0.5, -1.0, 20.0, -0.95, 4.0, 1.8, 1.5, math.pi / 2)
    sample = make_sample(level_from_lidar=quarter)
    own = sample.calibration.camera_from_lidar @ quarter
    calibration = dataclasses.replace(sample.calibration, camera_from_lidar=own)
    sample = dataclasses.replace(sample, calibration=calibration)
    found = join_detections(sample, None, detections3d(turned), MODELS)
    straight = join(None, detections3d(CAR))
    np.testing.assert_allclose(found.boxes3d.tensor[0].numpy(), turned[2:], atol=1e-6)
    torch.testing.assert_close(found.boxes2d.tensor, straight.boxes2d.tensor, rtol=0, atol=1e-3)


def test_a_share_outside_its_range_is_refused():
    for name in ("min_iou", "projected_share", "own_share", "min_proposed_score", "max_iou"):
        with pytest.raises(ValueError, match=name):
            JoinConfig(**{name: 1.5})


def test_returns_are_counted_outside_the_view_too_and_the_scores_stay():
    """An object behind the vehicle has its returns; evidence is of those in view, as fitted."""
    inside = [[x, y, -0.9, 0.1] for x in (-20.5, -19.5, 19.5, 20.5) for y in (0.5, 1.5)]
    whole, ahead = (
        join(None, detections3d(CAR, BEHIND), points=points, all_around=True)
        for points in (inside, [point for point in inside if point[0] > 0])
    )
    assert whole.num_points.tolist() == [4, 4]
    assert ahead.num_points.tolist() == [4, 0]
    assert whole.scores.tolist() == ahead.scores.tolist()

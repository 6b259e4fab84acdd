"""Lifted image boxes that the second stage refines."""

import dataclasses

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import sightline
from sightline.detection3d.predictor import Detection3DPredictor
from sightline.detection3d.sweeps import from_kitti_frame, to_kitti_boxes
from sightline.geometry.boxes3d import Boxes3D
from sightline.geometry.transforms import transform_points
from sightline.joining.config import JoinConfig
from sightline.joining.join import join_detections
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.structures.predictions import Detections3D
from tests.joining.scenes import (
    detections2d,
    detections3d,
    make_sample,
    own_score_models,
    select,
)
from tests.joining.test_join import CAR, CAR_IN_IMAGE

MODELS = own_score_models()
SEEN = detections2d(("Car", 0.5, CAR_IN_IMAGE))
REFINED = (20.0, 1.0, -0.95, 4.0, 1.8, 1.5, 0.0)


def returns(count=20, x=20.0):
    """Returns inside of `REFINED`, or of a box beside it."""
    rng = np.random.default_rng(0)
    low, high = (x - 1, 0.5, -1.2), (x + 1, 1.5, -0.7)
    return np.column_stack((rng.uniform(low, high, (count, 3)), np.zeros(count))).tolist()


class SecondStage:
    """Second stage that always finds `REFINED`, and notes what it was given."""

    def __init__(self, score=0.6):
        self.score, self.given = score, []

    def __call__(self, sample, boxes):
        assert sample.points is not None
        self.given.append(boxes)
        count = len(boxes.scores)
        return Detections3D(
            class_names=boxes.class_names,
            boxes=Boxes3D(torch.tensor([REFINED]).repeat(count, 1)),
            scores=torch.full((count,), self.score),
        )


def join(found2d, found3d, refine, points=None, **settings):
    sample = make_sample(returns() if points is None else points)
    return join_detections(sample, found2d, found3d, MODELS, JoinConfig(**settings), refine)


def test_an_image_box_without_a_3d_box_gets_a_refined_one_and_keeps_its_place():
    stage = SecondStage()
    found = join(SEEN, detections3d(), stage)
    (given,) = stage.given
    assert given.scores.tolist() == [pytest.approx(0.7 * 0.5)]
    assert given.boxes.tensor[0, :2].tolist() == pytest.approx([20, 1], abs=3)
    assert found.origins == ("refined",)
    torch.testing.assert_close(found.boxes3d.tensor[0], torch.tensor(REFINED).double())
    torch.testing.assert_close(found.boxes2d.tensor[0], torch.tensor(CAR_IN_IMAGE).double())
    assert found.scores3d[0].item() == pytest.approx(0.6)
    assert found.scores[0].item() == pytest.approx(1 - (1 - 0.5 * 0.6) * 0.5)
    assert found.num_points[0].item() == 20


@pytest.mark.parametrize(
    ("found2d", "points", "settings", "origins"),
    [
        (SEEN, None, {"propose": False}, ("lifted",)),
        (SEEN, None, {"associate": False}, ("lifted",)),
        (SEEN, None, {"propose": False, "lift": False}, ("none",)),
        (detections2d(("Car", 0.15, CAR_IN_IMAGE)), None, {}, ("lifted",)),
        (SEEN, None, {"sweep_in_image": False}, ("lifted",)),
        (SEEN, [], {}, ("lifted",)),
        (SEEN, returns(9), {}, ("lifted",)),
        (SEEN, returns(10), {}, ("refined",)),
        (SEEN, None, {"lift": False}, ("refined",)),
    ],
)
def test_boxes_that_are_doubtful_or_without_returns_stay_lifted(found2d, points, settings, origins):
    assert join(found2d, detections3d(), SecondStage(), points, **settings).origins == origins


def test_a_matched_image_box_is_not_proposed():
    stage = SecondStage()
    assert join(SEEN, detections3d(CAR), stage).origins == ("measured",)
    assert stage.given == []


@pytest.mark.parametrize(("score", "origin"), [(0.6, "refined"), (0.2, "measured")])
def test_of_two_boxes_in_one_place_the_surer_one_stays(score, origin):
    turned = ("Car", 0.4, 20.5, 1.0, -0.95, 0.5, 0.5, 0.4, 0.0)  # too small to be matched
    found = join(SEEN, detections3d(turned), SecondStage(score), max_iou_from_above=0.01)
    assert [each for each in found.origins if each != "lifted"] == [origin]


@pytest.fixture(scope="module")
def detector():
    return Detection3DPredictor.load("detection3d-best")


@pytest.fixture(scope="module")
def sample():
    return sightline.open_dataset(PACKAGED_FRAMES)[0]


def test_the_detectors_own_boxes_moved_a_little_are_found_again(detector, sample):
    found = detector(sample)
    sure = [index for index, score in enumerate(found.scores.tolist()) if score > 0.7]
    assert len(sure) > 2
    boxes = found.boxes.tensor[sure] + torch.tensor([0.3, -0.2, 0.1, 0, 0, 0, 0.05])
    given = dataclasses.replace(select(found, sure), boxes=Boxes3D(boxes))
    again = detector.refine_boxes(sample, given)
    assert sorted(again.class_names) == sorted(given.class_names)
    distances = torch.cdist(again.boxes.tensor[:, :3], found.boxes.tensor[sure, :3]).amin(dim=1)
    assert distances.max() < 0.15


def test_boxes_are_refined_in_the_frame_of_a_turned_lidar(detector, sample):
    turn = torch.tensor(
        [[0.0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], dtype=torch.float64
    )
    own_from_level = turn.T
    places = transform_points(own_from_level, sample.points[:, :3])
    turned = dataclasses.replace(
        sample,
        points=torch.cat((places.float(), sample.points[:, 3:]), dim=1),
        calibration=dataclasses.replace(
            sample.calibration, camera_from_lidar=sample.calibration.camera_from_lidar @ turn
        ),
        level_from_lidar=turn,
        objects=None,
    )
    found = detector(sample)
    given = dataclasses.replace(found, boxes=found.boxes.from_level(turn))
    expected = detector.refine_boxes(sample, found)
    again = detector.refine_boxes(turned, given)
    assert again.class_names == expected.class_names
    torch.testing.assert_close(
        again.boxes.to_level(turn).tensor[:, :3], expected.boxes.tensor[:, :3], rtol=0, atol=0.02
    )


@pytest.mark.parametrize(("name", "x"), [("Tram", 20.0), ("Car", 75.0), ("Car", -5.0)])
def test_boxes_of_unknown_classes_or_out_of_range_are_left_out(
    detector, sample, monkeypatch, name, x
):
    boxes = Boxes3D(torch.tensor([[x, *REFINED[1:]]]))
    found = Detections3D(class_names=(name,), boxes=boxes, scores=torch.tensor([0.9]))
    refine, taken = detector._stages.refine, []

    def note(sweep, proposed):
        taken.append(len(proposed.boxes))
        return refine(sweep, proposed)

    monkeypatch.setattr(detector._stages, "refine", note)
    assert len(detector.refine_boxes(sample, found).scores) == 0
    assert taken == [0]


@given(height_m=st.floats(0.5, 4), roll=st.floats(-0.3, 0.3), yaw=st.floats(-3, 3))
def test_boxes_go_to_kittis_frame_and_back(sample, height_m, roll, yaw):
    turn = torch.eye(4, dtype=torch.float64)
    turn[:3, :3] = torch.from_numpy(Rotation.from_euler("zx", (yaw, roll)).as_matrix())
    tilted = dataclasses.replace(sample, lidar_height_m=height_m, level_from_lidar=turn)
    boxes = Boxes3D(torch.tensor([REFINED], dtype=torch.float64))
    kitti = Detections3D(class_names=("Car",), boxes=boxes, scores=torch.tensor([0.9]))
    again = to_kitti_boxes(from_kitti_frame(kitti, tilted), tilted)
    torch.testing.assert_close(again.boxes.tensor, boxes.tensor, rtol=0, atol=1e-6)


def test_a_car_that_the_first_stage_lost_is_found_by_its_image_box(detector, sample):
    predictor = sightline.load("joined")
    found2d, found3d = predictor.detector2d(sample).detections, detector(sample)
    lost = found3d.class_names.index("Car")  # the surest one
    kept = [index for index in range(len(found3d.scores)) if index != lost]
    given = (sample, found2d, select(found3d, kept), predictor.models)
    found = join_detections(*given, refine=predictor.detector3d.refine_boxes)
    again = found.boxes3d.tensor[found.origins.index("refined")]
    torch.testing.assert_close(again[:3], found3d.boxes.tensor[lost, :3].double(), rtol=0, atol=0.2)
    assert "refined" not in join_detections(*given).origins

"""Late sweeps: measured by boxes over a drive, and joined without them in the image."""

import dataclasses

import numpy as np
import pytest
import torch

from sightline.geometry.boxes2d import Boxes2D
from sightline.joining.alignment import Alignment, AlignmentConfig
from sightline.joining.alignment_by_boxes import mutual_pairs
from sightline.joining.config import JoinConfig
from sightline.joining.join import join_detections
from sightline.joining.lateness import Advance, measure_advance
from sightline.joining.models import read_models
from sightline.joining.recording import measure_recording
from sightline.joining.scene import make_scene
from sightline.structures.lidar_turn import LidarTurn
from tests.joining.scenes import detections2d, detections3d, make_sample, own_score_models

PLACES = ((14.0, 3.0), (22.0, -4.0), (30.0, 6.0))
CAR = ("Car", 0.9, 20.0, 1.0, -0.95, 4.0, 1.8, 1.5, 0.0)
NEIGHBOURS = (
    ("Car", 0.8, (542.5, 191.0, 616.5, 252.5)),
    ("Car", 0.4, (562.5, 191.0, 638.5, 252.5)),
)
"""The projection of `CAR` [px], nearly, and a box with an IoU of 0.56 with it."""
LATE = JoinConfig(sweep_in_image=False)


@pytest.fixture(autouse=True)
def repeated_frames(monkeypatch):
    """Let frames that are repeated count as if each showed another scene."""
    monkeypatch.setattr("sightline.joining.recording.distinct_scenes", list)


def cars(advance_m=0.0, score=0.9):
    return detections3d(
        *(("Car", score, x + advance_m, y, -0.95, 4.0, 1.8, 1.5, 0.0) for x, y in PLACES)
    )


def seen(scores=(0.9, 0.8, 0.7)):
    """Boxes in the image where the cars are."""
    boxes = make_scene(make_sample(), None, cars()).sweep.in_image.tolist()
    return detections2d(*zip(("Car",) * 3, scores, map(tuple, boxes), strict=True))


def scenes(advance_m, count=5):
    return [make_scene(make_sample(), seen(), cars(advance_m))] * count


@pytest.mark.parametrize("advance_m", [-1.0, 0.0, 1.0, 2.0])
def test_the_way_driven_meanwhile_is_measured(advance_m):
    found = measure_advance(scenes(advance_m))
    assert found.metres == pytest.approx(advance_m, rel=0.2, abs=0.02)
    assert found.is_late == (advance_m > 0.3)
    assert measure_advance(scenes(advance_m, 20)).deviation == pytest.approx(found.deviation / 2)


def test_wrong_pairs_hardly_change_the_advance():
    """In every frame the nearest car is paired with a much smaller box beside it."""
    boxes = seen().boxes.tensor.clone()
    left, top, right, bottom = boxes[0].tolist()
    boxes[0] = torch.tensor(
        [left + 0.3 * (right - left), top, right, bottom - 0.4 * (bottom - top)]
    )
    wrong = dataclasses.replace(seen(), boxes=Boxes2D(boxes))
    scene = make_scene(make_sample(), wrong, cars(1.5))
    assert len(mutual_pairs(scene)[0]) == len(PLACES)
    assert measure_advance([scene] * 5).metres == pytest.approx(1.5, rel=0.2)


def test_a_turned_lidar_is_not_late():
    boxes = seen().boxes.tensor + torch.tensor([9.0, -4.0, 9.0, -4.0])
    shifted = dataclasses.replace(seen(), boxes=Boxes2D(boxes))
    found = measure_advance([make_scene(make_sample(), shifted, cars())] * 5)
    assert abs(found.metres) < 0.25
    assert not found.is_late


def test_without_pairs_nothing_is_known_and_a_doubtful_advance_does_not_count():
    assert measure_advance([make_scene(make_sample(), seen(), None)]) is None
    assert measure_advance([]) is None
    assert not Advance(0.9, 0.31).is_late
    assert not Advance(0.29, 0.01).is_late


def test_boxes_and_order_in_the_image_are_the_image_detectors_if_the_sweep_is_late():
    sample, models = make_sample([14.0, 3.0, -1.0, 0.0]), read_models()
    found2d, unseen = seen((0.6, 0.5, 0.3)), ("Car", 0.9, 40.0, -9.0, -0.95, 4.0, 1.8, 1.5, 0.0)
    given = cars(1.5)
    found3d = detections3d(unseen, *(("Car", 0.9, *box) for box in given.boxes.tensor.tolist()))
    found = join_detections(sample, found2d, found3d, models, LATE)
    assert found.origins[:3] == ("measured",) * 3
    torch.testing.assert_close(found.boxes2d.tensor[:3], found2d.boxes.tensor.double())
    assert found.image_support.tolist() == pytest.approx([0.6, 0.5, 0.3, 0.0])
    assert found.scores[3] < 0.1
    usual = join_detections(sample, found2d, found3d, models)
    assert sorted(found.scores3d.tolist()) == pytest.approx(sorted(usual.scores3d.tolist()))


def test_a_late_sweep_leaves_no_neighbour_out():
    found2d, found3d, models = detections2d(*NEIGHBOURS), detections3d(CAR), own_score_models()
    usual = join_detections(make_sample(), found2d, found3d, models)
    late = join_detections(make_sample(), found2d, found3d, models, LATE)
    assert len(late) == len(usual) + 1


def test_a_recording_with_edges_runs_no_detector(monkeypatch):
    def detect(_):
        raise AssertionError("edges vouch for it")

    monkeypatch.setattr("sightline.joining.recording.measure_alignment", lambda *_: Alignment())
    assert measure_recording([make_sample()] * 6, detect, AlignmentConfig()) == Alignment()


@pytest.mark.parametrize("by_edges", [None, Alignment(by_boxes=True)])
@pytest.mark.parametrize("advance_m", [0.0, 1.5])
def test_without_edges_detections_tell_whether_sweeps_are_late(monkeypatch, by_edges, advance_m):
    monkeypatch.setattr("sightline.joining.recording.measure_alignment", lambda *_: by_edges)
    samples = [dataclasses.replace(make_sample(), sample_id=f"{i:06d}") for i in range(40)]
    asked = []

    def detect(sample):
        asked.append(sample.sample_id)
        return seen(), cars(advance_m)

    found = measure_recording(samples, detect, AlignmentConfig())
    expected = Alignment(late=True) if advance_m else by_edges or Alignment()
    assert found == expected
    assert len(asked) == 15
    assert Alignment.from_json(found.to_json()) == found


def test_a_pitch_that_boxes_contradict_or_do_not_confirm_is_not_undone(monkeypatch):
    false = Alignment(turn=LidarTurn(pitch_deg=1.64))
    monkeypatch.setattr("sightline.joining.recording.measure_alignment", lambda *_: false)

    def detect(_):
        return seen(), cars(0.0)

    samples = [make_sample()] * 6
    for each in (detect, lambda _: (None, None)):
        assert measure_recording(samples, each, AlignmentConfig()) == Alignment()


def test_states_are_described():
    assert str(Alignment(late=True)).startswith("the sweeps are late behind the images")
    assert not Alignment()
    assert np.all([Alignment(late=True), Alignment(by_boxes=True)])

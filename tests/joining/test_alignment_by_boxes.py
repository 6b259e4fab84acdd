import pytest
import torch

from sightline.joining.alignment_by_boxes import DetectedFrame, confirm_turn, turn_by_boxes
from sightline.joining.scene import make_scene
from sightline.structures.lidar_turn import LidarTurn, undo_turn
from sightline.structures.predictions import Detections2D
from tests.joining.scenes import detections2d, detections3d, make_sample

CARS = tuple(
    ("Car", 0.9, x, y, -0.95, 4.0, 1.8, 1.5, 0.3)
    for x, y in ((15.0, 1.0), (25.0, -5.0), (35.0, 4.0))
)


def image_boxes(sample, *, score=0.9):
    """Boxes in the image exactly where the cars are."""
    boxes = make_scene(sample, None, detections3d(*CARS)).sweep.in_image.tolist()
    return detections2d(*(("Car", score, box) for box in boxes))


def misaligned(sample, **angles):
    """The sample with the calibration of a LiDAR that was turned since."""
    undone = LidarTurn(**{name: -angle for name, angle in angles.items()})
    return undo_turn(sample, undone)


@pytest.mark.parametrize(
    "angles", [{"yaw_deg": 1.0}, {"yaw_deg": -0.7}, {"pitch_deg": 0.6}, {"pitch_deg": -0.6}]
)
def test_a_common_shift_of_the_boxes_is_the_rotation(angles):
    sample = make_sample([9.0, 0, -1.7, 0])
    found2d = image_boxes(sample)
    found = turn_by_boxes(misaligned(sample, **angles), found2d, detections3d(*CARS))
    expected = LidarTurn(**angles)
    assert found.yaw_deg == pytest.approx(expected.yaw_deg, abs=0.1)
    assert found.pitch_deg == pytest.approx(expected.pitch_deg, abs=0.1)
    assert found.roll_deg == 0


def test_a_shift_within_the_usual_distance_is_no_rotation():
    sample = make_sample([9.0, 0, -1.7, 0])
    found2d = image_boxes(sample)
    assert not turn_by_boxes(misaligned(sample, yaw_deg=0.05), found2d, detections3d(*CARS))


@pytest.mark.parametrize("other", ["no camera", "unsure", "another class", "no boxes"])
def test_without_pairs_or_a_camera_nothing_is_undone(other):
    sample = make_sample([9.0, 0, -1.7, 0], image=other != "no camera")
    found2d = image_boxes(sample, score=0.1 if other == "unsure" else 0.9)
    if other == "another class":
        found2d = Detections2D(
            class_names=("Cyclist",) * 3, boxes=found2d.boxes, scores=found2d.scores
        )
    if other == "no boxes":
        found2d = found2d.select(torch.zeros(0, dtype=torch.int64))
    given = misaligned(sample, yaw_deg=1.0)
    assert not turn_by_boxes(given, found2d, detections3d(*CARS))
    assert not turn_by_boxes(given, None, None)


def test_boxes_cut_by_the_border_tell_nothing_of_yaw():
    sample = make_sample([9.0, 0, -1.7, 0])
    near = detections3d(("Car", 0.9, 5.0, 4.0, -0.95, 4.0, 1.8, 1.5, 0.0))
    (box,) = make_scene(sample, None, near).sweep.in_image.tolist()
    assert box[0] == 0  # cut on the left
    shifted = detections2d(("Car", 0.9, (box[0], box[1], box[2] - 90, box[3])))
    assert not turn_by_boxes(sample, shifted, near)


def detected(sample, **angles):
    """Frame whose LiDAR was turned, with the boxes of both detectors."""
    return DetectedFrame(misaligned(sample, **angles), image_boxes(sample), detections3d(*CARS))


@pytest.mark.parametrize(
    "turn",
    [
        LidarTurn(yaw_deg=1.0),
        LidarTurn(pitch_deg=-0.6),
        LidarTurn(yaw_deg=-0.5, pitch_deg=0.5, roll_deg=0.8),
    ],
)
def test_boxes_confirm_the_true_rotation(turn):
    sample = make_sample([9.0, 0, -1.7, 0])
    angles = turn.to_json()
    assert confirm_turn(turn, [detected(sample, **angles)] * 3) == turn


def test_boxes_drop_the_angles_that_move_them_apart():
    frames = [detected(make_sample([9.0, 0, -1.7, 0]), yaw_deg=1.0)] * 3
    false_pitch = LidarTurn(yaw_deg=1.0, pitch_deg=1.64)
    assert confirm_turn(false_pitch, frames) == LidarTurn(yaw_deg=1.0)
    assert not confirm_turn(LidarTurn(yaw_deg=-1.0, pitch_deg=1.64), frames)


def test_without_pairs_of_boxes_only_the_yaw_is_kept():
    sample, turn = make_sample([9.0, 0, -1.7, 0]), LidarTurn(yaw_deg=1.0, pitch_deg=1.64)
    for frames in ([DetectedFrame(sample, None, None)] * 3, []):
        assert confirm_turn(turn, frames) == LidarTurn(yaw_deg=1.0)

import dataclasses

import pytest
import torch

from benchmarks.joined_frames import CASES, DetectionStore, half_hidden, turned
from benchmarks.table_joined import faults, joined
from sightline.detection2d.predictor import DetectionResult
from sightline.structures.lidar_turn import LidarTurn, undo_turn
from tests.joining.scenes import detections2d, detections3d, make_sample

POINTS = [[20.0, 3.0, -1.0, 0.5], [8.0, -2.0, 0.5, 0.1]]


def test_half_of_a_sweep_is_hidden_in_turns():
    sample = make_sample(POINTS)
    assert half_hidden(sample, 0).points[:, 1].tolist() == [-2.0]
    assert half_hidden(sample, 1).points[:, 1].tolist() == [3.0]


def test_a_turned_lidar_keeps_its_sweep_and_undoing_restores_the_calibration():
    sample = make_sample(POINTS)
    changed = turned(-2.0)(sample, 0)
    assert changed.points is sample.points
    restored = undo_turn(changed, LidarTurn(yaw_deg=-2.0)).calibration
    torch.testing.assert_close(restored.camera_from_lidar, sample.calibration.camera_from_lidar)


def test_all_core_kinds_and_yaws_are_cases():
    assert {"yaw_0.5", "yaw_1", "yaw_2", "camera_fog-3", "misalignment_spatial-3"} <= set(CASES)
    assert len([case for case in CASES if case.endswith("-3")]) == 21


class Detectors:
    """Detectors that count their calls."""

    def __init__(self):
        self.calls = []

    def image(self, _):
        self.calls.append("image")
        return DetectionResult(detections=detections2d(("Car", 0.5, (100.0, 180, 200, 240))))

    def sweep(self, _):
        self.calls.append("sweep")
        return detections3d(("Car", 0.5, 20.0, 1.0, -0.95, 4.0, 1.8, 1.5, 0.0))


@pytest.fixture
def store(tmp_path):
    detectors = Detectors()
    kept = DetectionStore("a", "b", tmp_path)
    vars(kept).update(detector2d=detectors.image, detector3d=detectors.sweep)
    return kept, detectors.calls


def test_a_sweep_that_did_not_change_is_not_searched_again(store):
    kept, calls = store
    sample = make_sample(POINTS)
    first = kept.frame(sample, "yaw_1", 0, turned(1.0))
    assert calls == ["image", "image", "sweep"]  # with the sound frame's
    again = kept.frame(sample, "yaw_1", 0, turned(1.0))
    assert len(calls) == 3
    assert again.found3d.scores.tolist() == first.found3d.scores.tolist() == [0.5]
    blank = kept.frame(sample, "blank", 0, lambda each, _: dataclasses.replace(each, points=None))
    assert blank.found3d is None


def rows_of(case, **scores):
    """Rows of all scores of a case, with the same numbers."""
    undone = {"yaw_deg": 1.013 if case == "yaw_1" else 0.0, "pitch_deg": 0.0, "roll_deg": 0.0}
    told = {"case": case, "undone": undone, "by_boxes": case == "lidar_fog-3"}
    columns = (("bbox", 0.7), ("3d", 0.7), ("3d", 0.5), ("centre_2m", None), ("bbox", 0.5))
    return [
        {"class": name, "metric": metric, "iou": iou, **told, **scores}
        for name in ("Car", "Pedestrian")
        for metric, iou in columns
    ]


def test_rows_of_faults_tell_what_was_undone_and_compare_with_the_better():
    better = {"sweep": 70.0, "less_sweep_95": [-3.0, 4.0]}
    worse = {"image": 60.0, "less_image_95": [1.0, 2.0]}
    results = rows_of("yaw_1", joined=71.04, **worse, **better)
    results += rows_of("lidar_fog-3", joined=51.0, sweep=50.0, less_sweep_95=None)
    heading, first, second = faults({"results": results})
    assert heading[:3] == ["fault", "undone", "cars in the image, IoU 0.7"]
    cell = "60.0 / 70.0 -> **71.0** [-3.0, +4.0]"
    assert first[:3] == ["LiDAR turned by 1 deg", "yaw 1.01 deg", cell]
    assert second[:2] == ["`lidar_fog`, severity 3", "frame by frame"]
    assert second[5] == "50.0 -> **51.0**"


def test_choices_of_rings_are_averaged():
    results = rows_of("beams_16_from_0", sweep=50.0, joined=60.0)
    results += rows_of("beams_16_from_2", sweep=52.0, joined=62.0)
    rows = joined({"results": results, "sample_list": "sample_val", "frames": 29})
    assert rows[1][:2] == ["sample_val, 29", "16 beams, mean of 2 choices of rings"]
    assert rows[1][3] == "51.0 -> **61.0**"

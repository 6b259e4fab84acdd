import torch

from sightline.corruptions.suites import find_suite
from sightline.detection2d.predictor import DetectionResult
from sightline.detection2d.robustness import SCORING
from sightline.geometry.boxes2d import Boxes2D
from sightline.robustness.scoring import BenchFrame, BenchPrediction
from sightline.structures.predictions import Detections2D
from tests.detection2d.frames import painted_frame


def prediction(case_name, *, gates):
    sample = painted_frame(1)
    (case,) = find_suite("dgfn7").select([case_name])
    maps = {"camera_gate": torch.full((4, 5), 0.25), "lidar_gate": torch.ones(4, 5)}
    result = DetectionResult(
        detections=Detections2D(
            class_names=("Car",),
            boxes=Boxes2D(torch.tensor([[20.0, 30.0, 90.0, 80.0]])),
            scores=torch.tensor([0.9]),
        ),
        **(maps if gates else {}),
    )
    return BenchPrediction(BenchFrame(sample, None), case.corrupt(sample), result)


def test_an_answer_is_drawn_with_what_the_gates_let_through():
    panels = SCORING.draw(prediction("camera_occlusion", gates=True), 200)
    captions = [panel.caption for panel in panels]
    assert captions == ["detections", "camera gate mean 0.25", "LiDAR gate mean 1.00"]
    assert all(panel.picture.shape[1] == 200 for panel in panels)


def test_a_network_without_gates_has_one_picture_with_its_boxes():
    drawn = prediction("camera_blank", gates=False)
    (panel,) = SCORING.draw(drawn, 200)
    assert panel.picture.any()  # boxes on black


def test_what_is_kept_is_what_predict_writes(tmp_path):
    path = tmp_path / "000001.txt"
    SCORING.store(path, prediction("clean", gates=False))
    assert path.read_text().startswith("Car -1")
    assert SCORING.metrics[0].name == "Car_bbox_0.7_moderate_R40"

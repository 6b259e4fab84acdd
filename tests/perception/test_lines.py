"""Line of a frame: contents that no other test checks."""

import json

import torch

from sightline.geometry.boxes3d import Boxes3D
from sightline.perception.lines import frame_line
from sightline.perception.perceiver import FramePredictions
from sightline.structures.predictions import Detections3D
from sightline.tasks import LINE_KEYS
from tests.data.recordings import SAMPLE


def test_boxes_in_space_are_written_as_they_were_found():
    boxes = Boxes3D(torch.tensor([[10.0, 2.0, -1.0, 4.0, 1.6, 1.5, 0.5]]))
    detections = Detections3D(class_names=("Car",), boxes=boxes, scores=torch.tensor([0.75]))
    predictions = FramePredictions(
        by_task={"detection3d": detections}, milliseconds={"detection3d": 1.0}, lacks={}
    )
    line = json.loads(frame_line(SAMPLE, predictions, {"detection3d": "test"}))
    assert {*line, "undone_turn"} == set(LINE_KEYS)
    (entry,) = json.loads(frame_line(SAMPLE, predictions, {"detection3d": "test"}))["detections3d"]
    assert entry["center_m"] == [10.0, 2.0, -1.0]
    assert entry["size_m"] == [4.0, 1.6, 1.5]
    assert entry["yaw_rad"] == 0.5

"""The line of a frame, as far as other tests do not read it by the way."""

import json

import torch

from sightline.geometry.boxes3d import Boxes3D
from sightline.perception.lines import frame_line
from sightline.perception.perceiver import FrameAnswers
from sightline.structures.predictions import Detections3D
from tests.data.recordings import SAMPLE


def test_boxes_in_space_are_written_as_they_were_found():
    boxes = Boxes3D(torch.tensor([[10.0, 2.0, -1.0, 4.0, 1.6, 1.5, 0.5]]))
    found = Detections3D(class_names=("Car",), boxes=boxes, scores=torch.tensor([0.75]))
    answered = FrameAnswers(
        answers={"detection3d": found}, milliseconds={"detection3d": 1.0}, lacks={}
    )
    (told,) = json.loads(frame_line(SAMPLE, answered, {"detection3d": "test"}))["detections3d"]
    assert told["center_m"] == [10.0, 2.0, -1.0]
    assert told["size_m"] == [4.0, 1.6, 1.5]
    assert told["yaw_rad"] == 0.5

"""The line of a frame, as far as other tests do not read it by the way."""

import json
import math
from dataclasses import replace

import pytest
import torch

from sightline.geometry.boxes3d import Boxes3D
from sightline.perception.lines import frame_line
from sightline.perception.perceiver import FrameAnswers
from sightline.structures.predictions import Detections3D
from tests.data.recordings import SAMPLE


@pytest.mark.parametrize("turned_deg", [0, 90, -50])
def test_boxes_in_space_are_told_in_the_frame_of_the_lidar_as_it_is_mounted(turned_deg):
    turn = math.radians(turned_deg)
    ahead = Boxes3D(torch.tensor([[10.0, 2.0, -1.0, 4.0, 1.6, 1.5, 0.5]]))
    found = Detections3D(class_names=("Car",), boxes=ahead, scores=torch.tensor([0.75]))
    answered = FrameAnswers(
        answers={"detection3d": found}, milliseconds={"detection3d": 1.0}, lacks={}
    )
    sample = replace(SAMPLE, turned_rad=turn)
    (told,) = json.loads(frame_line(sample, answered, {"detection3d": "test"}))["detections3d"]
    x, y = 10 * math.cos(turn) - 2 * math.sin(turn), 10 * math.sin(turn) + 2 * math.cos(turn)
    assert told["center_m"] == pytest.approx([x, y, -1], abs=1e-3)
    assert told["size_m"] == [4.0, 1.6, 1.5]
    assert told["yaw_rad"] == pytest.approx(0.5 + turn, abs=1e-4)

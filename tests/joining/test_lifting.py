import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from sightline.geometry.boxes3d import Boxes3D
from sightline.joining.lifting import LIFTED_COLUMNS, lift
from sightline.joining.scene import make_scene, project_upright
from tests.joining.scenes import detections2d, make_sample

ROAD_M = -1.73
SIZES = {"Car": (3.88, 1.63, 1.53), "Pedestrian": (0.84, 0.66, 1.76)}


def box_of(name, x, y, yaw=0.0):
    length, width, height = SIZES[name]
    return Boxes3D(torch.tensor([[x, y, ROAD_M + height / 2, length, width, height, yaw]]).double())


def lifted(name, box, points=None, score=0.5):
    """Lift the projection of a box."""
    sample = make_sample(points)
    (corners,) = project_upright(box, sample).tolist()
    return lift(make_scene(sample, detections2d((name, score, corners)), None), [0])[0]


@settings(max_examples=30)
@given(
    name=st.sampled_from(sorted(SIZES)),
    x=st.floats(9, 60),
    bearing=st.floats(-0.4, 0.4),
)
def test_a_box_of_the_class_size_on_the_road_is_found_where_it_is(name, x, bearing):
    box = box_of(name, x, bearing * x)
    found = lifted(name, box)
    error_m = np.hypot(*(found.box[:2] - box.tensor[0, :2].numpy()))
    assert error_m < 0.3 + 0.02 * x
    assert abs(found.box[2] - box.tensor[0, 2].item()) < 0.3
    assert len(found.evidence) == len(LIFTED_COLUMNS)
    assert 0 < found.range_error_m < 0.08 * x


def test_a_car_across_the_street_is_seen_to_be_so():
    found = lifted("Car", box_of("Car", 15.0, 0.0, math.pi / 2))
    assert abs(abs(found.box[6]) - math.pi / 2) < 0.2


def test_returns_decide_the_distance_of_a_car_that_is_larger_than_its_class():
    box = box_of("Car", 20.0, 0.0)
    large = Boxes3D(box.tensor * torch.tensor([1, 1, 1, 1.25, 1.25, 1.25, 1]).double())
    rear = np.linspace(-0.7, 0.7, 20)
    points = np.stack((np.full(20, 20 - 3.88 / 2), rear, np.full(20, -1.0), np.zeros(20)), axis=1)
    error_m = abs(lifted("Car", large).box[0] - 20)
    with_points_m = abs(lifted("Car", large, points).box[0] - 20)
    assert with_points_m < error_m / 2
    assert with_points_m < 0.8


def test_farther_boxes_are_less_sure_and_returns_make_them_surer():
    near, far = (lifted("Car", box_of("Car", x, 0.0)) for x in (10.0, 50.0))
    assert near.range_error_m < far.range_error_m
    points = [(48.0, 0.1 * row - 0.5, -1.0, 0.0) for row in range(10)]
    assert lifted("Car", box_of("Car", 50.0, 0.0), points).range_error_m < far.range_error_m


def test_a_box_cut_by_the_border_is_marked_and_finite():
    found = lifted("Car", box_of("Car", 4.0, 2.5))
    assert np.isfinite(found.box).all()
    assert found.evidence[LIFTED_COLUMNS.index("at the image's border")] == 1
    assert 2 < found.box[0] < 8.5  # the road is seen from 6 m on


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("origin_m", [0.0, -0.09, 0.33, 4.0])
def test_the_height_of_the_points_origin_moves_no_box(origin_m):
    """Only the precision of the road's distance is taken from another height near the camera's."""
    sample, box = make_sample(), box_of("Car", 36.0, 3.0)
    (corners,) = project_upright(box, sample).tolist()
    corners[1] += 6.0  # road and size disagree
    found = detections2d(("Car", 0.5, corners))
    raised = torch.eye(4).double()
    raised[2, 3] = origin_m + ROAD_M  # from the frame of an origin at this height
    calibration = replace(
        sample.calibration, camera_from_lidar=sample.calibration.camera_from_lidar @ raised
    )
    moved = replace(sample, calibration=calibration, lidar_height_m=origin_m)
    expected, seen = (
        lift(make_scene(each, found, None), [0])[0].box[:2] for each in (sample, moved)
    )
    assert np.hypot(*(seen - expected)) < 0.1

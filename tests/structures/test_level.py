"""Tilted or rotated LiDARs: frames of points, labels and boxes, and estimates of the mounting."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from sightline.augmentation.sample_changes import mirror
from sightline.augmentation.scene_changes import turn_scene
from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.boxes3d import Boxes3D
from sightline.geometry.calibration import Calibration
from sightline.geometry.tilt import Tilt, level_ahead
from sightline.geometry.transforms import transform_points
from sightline.structures.level import (
    level_detections,
    level_sample,
    level_view,
    mounted_detections,
    mounted_labels,
)
from sightline.structures.objects import Objects
from sightline.structures.predictions import Detections3D, Perception
from sightline.structures.sample import CameraLidarSample
from tests.data.recordings import CAMERA_FROM_LIDAR, CAMERA_MATRIX, IMAGE, POINTS, SAMPLE

angles = st.floats(-25, 25)


def mounted_arrays(tilt, yaw_deg=0.0):
    """Calibration and points of the simulated frame, for a LiDAR that is rotated, then tilted."""
    cos, sin = math.cos(math.radians(yaw_deg)), math.sin(math.radians(yaw_deg))
    level_from_lidar = np.eye(4)
    level_from_lidar[:2, :2] = [[cos, sin], [-sin, cos]]
    level_from_lidar = level_from_lidar @ tilt.level_from_lidar
    calibration = Calibration.from_matrices(CAMERA_MATRIX, CAMERA_FROM_LIDAR @ level_from_lidar)
    places = POINTS[:, :3].astype(np.float64) @ level_from_lidar[:3, :3]
    return calibration, np.column_stack((places, POINTS[:, 3]))


LEVEL = Tilt(roll_deg=0.0, pitch_deg=0.0)
TILTED = Tilt(roll_deg=3.0, pitch_deg=12.0)


@settings(max_examples=50)
@given(roll=angles, pitch=angles, turn=st.floats(-180, 180), yaw=st.floats(-3.1, 3.1))
def test_a_box_comes_back_from_the_frame_of_a_tilted_and_turned_lidar(roll, pitch, turn, yaw):
    yaw_rotation = np.eye(4)
    cos, sin = math.cos(math.radians(turn)), math.sin(math.radians(turn))
    yaw_rotation[:2, :2] = [[cos, -sin], [sin, cos]]
    level_from_lidar = torch.from_numpy(
        yaw_rotation @ Tilt(roll_deg=roll, pitch_deg=pitch).level_from_lidar
    )
    box = Boxes3D(torch.tensor([[12.0, -3.0, -0.9, 4.0, 1.8, 1.5, yaw]], dtype=torch.float64))
    mounted = box.from_level(level_from_lidar)
    torch.testing.assert_close(
        transform_points(level_from_lidar, mounted.centers), box.centers, rtol=0, atol=1e-9
    )
    torch.testing.assert_close(
        mounted.to_level(level_from_lidar).tensor, box.tensor, rtol=0, atol=1e-9
    )


def test_a_box_before_a_lidar_whose_front_is_lowered_lies_higher_in_its_frame():
    level_from_lidar = torch.from_numpy(Tilt(roll_deg=0.0, pitch_deg=12.0).level_from_lidar)
    box = Boxes3D(torch.tensor([[20.0, 0.0, -1.0, 4.0, 1.8, 1.5, 0.0]], dtype=torch.float64))
    mounted = box.from_level(level_from_lidar).tensor[0].tolist()
    sin, cos = math.sin(math.radians(12)), math.cos(math.radians(12))
    expected = [20 * cos + sin, 0.0, 20 * sin - cos, 4.0, 1.8, 1.5, 0.0]
    assert mounted == pytest.approx(expected)


@pytest.mark.parametrize("yaw_deg", [0.0, -50.0, 90.0, 179.0])
def test_arrays_of_a_lidar_that_is_turned_are_levelled_without_a_word(yaw_deg):
    calibration, points = mounted_arrays(LEVEL, yaw_deg)
    made = CameraLidarSample.from_arrays(calibration, image=IMAGE, points=points)
    np.testing.assert_allclose(made.points.numpy(), points, atol=1e-4)
    assert (made.level_from_lidar is None) == (yaw_deg == 0)
    torch.testing.assert_close(level_sample(made).points, SAMPLE.points, rtol=0, atol=1e-4)
    assert made.lidar_height_m == pytest.approx(1.73, abs=0.1)


@pytest.mark.parametrize("yaw_deg", [0.0, 90.0])
@pytest.mark.parametrize("tilt", [TILTED, Tilt(roll_deg=-12.0, pitch_deg=0.0)], ids=str)
def test_arrays_of_a_lidar_that_is_tilted_are_levelled_with_a_warning(tilt, yaw_deg):
    calibration, points = mounted_arrays(tilt, yaw_deg)
    with pytest.warns(UserWarning, match="the LiDAR is tilted, .* give lidar_tilt_deg=.roll, "):
        made = CameraLidarSample.from_arrays(calibration, image=IMAGE, points=points)
    np.testing.assert_allclose(made.points.numpy(), points, atol=1e-4)
    assert made.lidar_height_m == pytest.approx(1.73, abs=0.1)
    up = level_sample(made).calibration.camera_from_lidar[1, :3]
    assert float(up[2]) < -math.cos(math.radians(1.5))


def test_a_tilt_and_a_height_that_are_given_are_taken_as_they_are():
    calibration, points = mounted_arrays(TILTED)
    with pytest.warns(UserWarning, match=r"lidar_height_m is 0, but the road .* gives 1\.7"):
        made = CameraLidarSample.from_arrays(
            calibration, image=IMAGE, points=points, lidar_tilt_deg=(3, 12), lidar_height_m=0
        )
    torch.testing.assert_close(level_sample(made).points, SAMPLE.points, rtol=0, atol=1e-4)
    assert made.higher_than_kitti_m == pytest.approx(-1.73)
    with pytest.warns(UserWarning, match="lidar_tilt_deg is .* the road in the sweeps gives "):
        flat = CameraLidarSample.from_arrays(
            calibration, image=IMAGE, points=points, lidar_tilt_deg=np.zeros(2), lidar_height_m=1.7
        )
    assert level_sample(flat).points.equal(made.points)


def test_a_height_that_has_to_be_assumed_is_warned_of():
    calibration, points = mounted_arrays(LEVEL)
    with pytest.warns(UserWarning, match=r"too little of the road .* KITTI's 1.73 m is assumed"):
        made = CameraLidarSample.from_arrays(calibration, image=IMAGE, points=points[:20])
    assert made.higher_than_kitti_m == 0


def test_a_tilt_that_has_to_be_assumed_beside_a_given_height_is_warned_of():
    calibration, points = mounted_arrays(LEVEL)
    random = np.random.default_rng(0)
    cloud = random.uniform((5, -15, 1, 0), (35, 15, 6, 1), (4000, 4)).astype(np.float32)
    with pytest.warns(UserWarning, match=r"find the LiDAR's tilt .* give lidar_tilt_deg"):
        CameraLidarSample.from_arrays(calibration, image=IMAGE, points=cloud, lidar_height_m=6.0)
    CameraLidarSample.from_arrays(calibration, image=IMAGE, points=points[:20], lidar_height_m=6.0)


def test_points_whose_z_axis_points_down_are_warned_of_with_what_to_convert():
    turn = np.diag([1.0, -1.0, -1.0, 1.0])
    down = POINTS * np.float32([1, -1, -1, 1])
    with pytest.warns(UserWarning, match="convert both, points and transform"):
        calibration = Calibration.from_matrices(CAMERA_MATRIX, CAMERA_FROM_LIDAR @ turn)
    with pytest.warns(UserWarning, match="the cloud has its road .* convert both, points and cam"):
        CameraLidarSample.from_arrays(calibration, image=IMAGE, points=down)


@pytest.fixture
def tilted():
    """The simulated frame of a tilted LiDAR with its labels."""
    level_from_lidar = torch.from_numpy(
        level_ahead(SAMPLE.calibration.camera_from_lidar.numpy() @ TILTED.level_from_lidar, TILTED)
    )
    mounted_from_level = level_from_lidar.T
    points = SAMPLE.points.clone()
    points[:, :3] = transform_points(mounted_from_level, points[:, :3])
    return replace(
        SAMPLE,
        points=points,
        objects=mounted_labels(SAMPLE.objects, level_from_lidar),
        calibration=replace(
            SAMPLE.calibration,
            camera_from_lidar=SAMPLE.calibration.camera_from_lidar @ level_from_lidar,
        ),
        level_from_lidar=level_from_lidar,
    )


def test_a_sample_in_its_level_frame_is_that_of_a_level_lidar(tilted):
    level = level_sample(tilted)
    torch.testing.assert_close(level.points, SAMPLE.points, rtol=0, atol=1e-4)
    ours, true = level.objects.boxes3d.tensor, SAMPLE.objects.boxes3d.tensor
    torch.testing.assert_close(ours, true, rtol=0, atol=1e-9)
    assert level.level_from_lidar is None
    assert level_sample(level) is level


def test_detections_go_to_the_level_frame_and_back(tilted):
    boxes = Boxes3D(SAMPLE.objects.boxes3d.tensor[SAMPLE.objects.has_box3d].float())
    found = Detections3D(
        class_names=("Car",) * len(boxes), boxes=boxes, scores=torch.ones(len(boxes))
    )
    mounted = mounted_detections(found, tilted)
    assert (mounted.boxes.centers[:, 2] - boxes.centers[:, 2]).abs().max() > 1
    level = level_detections(mounted, tilted)
    torch.testing.assert_close(level.boxes.tensor, boxes.tensor, rtol=0, atol=1e-4)
    assert mounted_detections(found, SAMPLE) is found
    sample, perception = level_view(tilted, Perception(detections3d=mounted))
    torch.testing.assert_close(
        perception.detections3d.boxes.tensor, boxes.tensor, rtol=0, atol=1e-4
    )
    assert sample.level_from_lidar is None


def test_objects_are_drawn_in_the_level_frame_and_missing_boxes_stay_zero(tilted):
    level_boxes = Boxes3D(SAMPLE.objects.boxes3d.tensor[SAMPLE.objects.has_box3d][:2].double())
    mounted = level_boxes.from_level(tilted.level_from_lidar).tensor
    mounted[1] = 0.0
    ones = torch.ones(2, dtype=torch.float64)
    objects = Objects(
        class_names=("Car", "Car"),
        boxes2d=Boxes2D(torch.zeros(2, 4, dtype=torch.float64)),
        boxes3d=Boxes3D(mounted),
        origins=("measured", "none"),
        scores=ones,
        scores3d=ones,
        image_support=ones,
        lidar_support=ones,
        num_points=torch.zeros(2).long(),
    )
    found = level_view(tilted, Perception(objects=objects))[1].objects.boxes3d.tensor
    torch.testing.assert_close(found[0], level_boxes.tensor[0], rtol=0, atol=1e-9)
    assert found[1].tolist() == [0.0] * 7


def test_changed_scenes_keep_their_level_frame(tilted):
    expected = level_sample(tilted).points[:, :3]
    turned = level_sample(turn_scene(tilted, 40.0)).points[:, :3]
    torch.testing.assert_close(turned, expected, rtol=0, atol=1e-4)
    mirrored = level_sample(mirror(tilted)).points[:, :3]
    flip = expected.new_tensor([1, -1, 1])
    torch.testing.assert_close(mirrored, expected * flip, rtol=0, atol=1e-4)

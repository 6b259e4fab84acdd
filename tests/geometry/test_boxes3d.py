import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.geometry.boxes3d import (
    Boxes3D,
    boxes3d_from_kitti,
    kitti_from_boxes3d,
    yaw_from_kitti_rotation,
)
from tests.geometry.cameras import kitti_like_calibration
from tests.reference import geometry as reference

coordinates = st.floats(-50, 50)
sizes = st.floats(0.1, 20)
box_rows = st.tuples(*[coordinates] * 3, *[sizes] * 3, st.floats(-math.pi, 3.14))


def one_box(*row):
    return Boxes3D(torch.tensor([row], dtype=torch.float64))


@given(row=box_rows)
def test_corners_equal_the_reference(row):
    corners = one_box(*row).corners()[0].tolist()
    assert corners == [pytest.approx(corner, abs=1e-9) for corner in reference.box_corners(row)]


@given(rows=st.lists(box_rows, max_size=4), seed=st.integers(0, 99))
def test_points_in_boxes_equal_the_reference(rows, seed):
    points = torch.rand(30, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
    points = (points - 0.5) * 60
    boxes = Boxes3D(torch.tensor(rows, dtype=torch.float64).reshape(-1, 7))
    expected = [[reference.box_contains(row, point) for point in points.tolist()] for row in rows]
    assert boxes.contain(points).tolist() == expected


def test_the_faces_belong_to_the_box():
    on_faces = torch.tensor([[2.0, 0.0, 0.0], [0.0, 1.0, 0.0], [2.001, 0.0, 0.0]]).double()
    assert one_box(0, 0, 0, 4, 2, 1, 0).contain(on_faces).tolist() == [[True, True, False]]


def test_points_are_found_in_a_box_ten_kilometres_away():
    far = one_box(1e4, -1e4, 0, 4, 2, 1, 0.5)
    inside = far.centers[0] + torch.tensor([[0.5, 0.2, 0.1]]).double()
    assert far.contain(inside).item()
    assert far.to_canonical(far.corners()[0]).abs().max().item() == pytest.approx(2, abs=1e-9)


def test_canonical_coordinates_of_the_corners_are_the_half_sizes():
    box = one_box(3, -2, 1, 4, 2, 1, 2.5)
    canonical = box.to_canonical(box.corners()[0])[0]
    torch.testing.assert_close(canonical.abs(), torch.tensor([[2.0, 1.0, 0.5]] * 8).double())
    assert canonical[0].tolist() == pytest.approx([2, 1, -0.5])  # front left bottom


@given(row=box_rows, yaw_rad=st.floats(-7, 7))
def test_the_corners_of_turned_boxes_are_the_corners_turned(row, yaw_rad):
    turned = one_box(*row).turn(yaw_rad)
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    expected = [(cos * x - sin * y, sin * x + cos * y, z) for x, y, z in reference.box_corners(row)]
    assert turned.corners()[0].tolist() == [pytest.approx(each, abs=1e-9) for each in expected]
    assert -math.pi <= turned.yaws.item() < math.pi


def test_enlarging_grows_each_size_by_twice_the_margin_and_keeps_the_rest():
    grown = one_box(1, 2, 3, 4, 2, 1, 0.3).enlarge(1.0)
    assert grown.tensor[0].tolist() == pytest.approx([1, 2, 3, 6, 4, 3, 0.3])


@given(row=box_rows)
def test_kitti_columns_and_boxes_convert_both_ways(row):
    camera_from_lidar = kitti_like_calibration().camera_from_lidar
    columns = kitti_from_boxes3d(one_box(*row), camera_from_lidar)
    back = boxes3d_from_kitti(*columns, camera_from_lidar)
    assert back.tensor[0, :6].tolist() == pytest.approx(row[:6], abs=1e-9)
    assert math.cos(back.tensor[0, 6].item() - row[6]) == pytest.approx(1)


def test_convention_kitti_rotation_zero_faces_right_which_is_minus_y_in_the_lidar_frame():
    assert yaw_from_kitti_rotation(torch.tensor([0.0])).item() == pytest.approx(-math.pi / 2)


def test_convention_kitti_places_the_bottom_centre_and_the_lidar_frame_the_geometric_one():
    camera_from_lidar = kitti_like_calibration().camera_from_lidar
    _, bottom_centers, _ = kitti_from_boxes3d(one_box(10, 0, 0, 4, 2, 1.5, 0), camera_from_lidar)
    assert bottom_centers[0, 1].item() == pytest.approx(-0.08 + 0.75)


def test_convention_a_box_of_yaw_zero_faces_forward_with_its_left_side_on_the_left():
    corners = one_box(10, 0, 0, 4, 2, 1, 0).corners()[0]
    assert corners[0].tolist() == [12, 1, -0.5]


def test_the_view_from_above_has_length_along_the_heading():
    assert one_box(1, 2, 3, 4, 5, 6, 0.5).bev.tolist() == [[1, 2, 4, 5, 0.5]]

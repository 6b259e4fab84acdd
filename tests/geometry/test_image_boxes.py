import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.geometry.boxes3d import Boxes3D, kitti_from_boxes3d
from sightline.geometry.image_boxes import kitti_corners, project_boxes
from tests.geometry.cameras import IMAGE_FROM_CAMERA, kitti_like_calibration
from tests.reference import image_boxes as reference

SIZE = (375, 1242)
boxes = st.tuples(
    st.tuples(st.floats(0.3, 4), st.floats(0.3, 3), st.floats(0.3, 16)),  # height, width, length
    st.tuples(st.floats(-30, 30), st.floats(-3, 5), st.floats(-10, 80)),
    st.floats(-math.pi, math.pi),
)


def project(rows, image_size=SIZE):
    table = torch.tensor([[*a, *b, c] for a, b, c in rows], dtype=torch.float64).reshape(-1, 7)
    corners = kitti_corners(table[:, :3], table[:, 3:6], table[:, 6])
    matrix = torch.tensor(IMAGE_FROM_CAMERA, dtype=torch.float64)
    return project_boxes(corners, matrix, image_size).tensor


@given(rows=st.lists(boxes, max_size=4))
def test_a_box_is_that_of_its_edges_within_the_image(rows):
    found = project(rows)
    assert found.shape == (len(rows), 4)
    for row, box in zip(rows, found.tolist(), strict=True):
        expected = reference.image_box(*row, IMAGE_FROM_CAMERA, SIZE)
        if expected is None:
            assert all(math.isnan(value) for value in box)
        else:
            np.testing.assert_allclose(box, expected, atol=1e-6)


def test_a_box_before_the_camera_is_bounded_by_its_corners():
    (box,) = project([((1.5, 1.6, 4.0), (2.0, 1.5, 20.0), 0.3)])
    corners = reference.corners_of((1.5, 1.6, 4.0), (2.0, 1.5, 20.0), 0.3).values()
    points = np.array([[*corner, 1] for corner in corners]) @ np.array(IMAGE_FROM_CAMERA).T
    pixels = points[:, :2] / points[:, 2:]
    np.testing.assert_allclose(box, [*pixels.min(axis=0), *pixels.max(axis=0)])


def test_a_box_beside_the_camera_ends_where_its_edges_leave_the_image():
    (box,) = project([((1.5, 1.6, 12.0), (2.5, 1.6, 4.0), -math.pi / 2)])
    assert box[2] == SIZE[1] - 1
    assert box[0] > SIZE[1] / 2


@pytest.mark.parametrize("place", [(0.0, 1.5, -5.0), (60.0, 1.5, 10.0), (0.0, -40.0, 20.0)])
def test_a_box_that_the_image_does_not_show_has_no_bounds(place):
    assert project([((1.5, 1.6, 4.0), place, 0.0)]).isnan().all()


def test_the_corners_are_those_of_the_box_in_the_lidar_frame():
    calibration = kitti_like_calibration()
    found = torch.tensor([[20.0, 3.0, -1.0, 4.0, 1.6, 1.5, 0.4]], dtype=torch.float64)
    corners = kitti_corners(*kitti_from_boxes3d(Boxes3D(found), calibration.camera_from_lidar))
    in_lidar = Boxes3D(found).corners()[0]
    expected = in_lidar @ calibration.camera_from_lidar[:3, :3].T
    expected = expected + calibration.camera_from_lidar[:3, 3]
    order = [sorted(map(tuple, each.round(decimals=6).tolist())) for each in (corners[0], expected)]
    np.testing.assert_allclose(order[0], order[1], atol=1e-5)

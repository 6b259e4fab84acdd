"""Clouds in other conventions, made of a simulated one."""

import numpy as np
import pytest

from sightline.geometry.mount_axes import axes_doubt
from tests.data.recordings import CAMERA_FROM_LIDAR, POINTS

# The axes of each frame, in ours.
FRAMES = {
    "forward-right-down": [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
    "a camera's": [[0, -1, 0], [0, 0, -1], [1, 0, 0]],
    "OpenGL's": [[0, -1, 0], [0, 0, 1], [-1, 0, 0]],
    "x up": [[0, 0, 1], [1, 0, 0], [0, 1, 0]],
}


def rigid(rows):
    matrix = np.eye(4)
    matrix[:3, :3] = rows
    return matrix


@pytest.mark.parametrize("name", FRAMES)
def test_a_cloud_of_another_convention_is_converted_with_its_calibration_or_alone(name):
    other_from_ours = rigid(FRAMES[name])
    cloud = POINTS[:, :3] @ other_from_ours[:3, :3].T
    problem, remedy = axes_doubt(cloud, CAMERA_FROM_LIDAR @ other_from_ours.T)
    assert "expected x forward, y left, z up" in problem
    assert remedy.startswith("convert both, points and camera_from_lidar: points x, y, z become ")
    _, remedy = axes_doubt(cloud, CAMERA_FROM_LIDAR)
    assert remedy.startswith("convert only the points")


def test_the_conversion_that_is_named_makes_both_right():
    other_from_ours = rigid(FRAMES["forward-right-down"])
    cloud = POINTS[:, :3] @ other_from_ours[:3, :3].T
    problem, remedy = axes_doubt(cloud, CAMERA_FROM_LIDAR @ other_from_ours.T)
    assert "so that -z points up" in problem
    assert "points x, y, z become x, -y, -z" in remedy
    assert (
        "camera_from_lidar @ [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]]" in remedy
    )


def test_clouds_with_z_up_are_not_doubted_wherever_x_points():
    east_north_up = rigid([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    assert axes_doubt(POINTS, CAMERA_FROM_LIDAR) is None
    cloud = POINTS[:, :3] @ east_north_up[:3, :3].T
    assert axes_doubt(cloud, CAMERA_FROM_LIDAR @ east_north_up.T) is None
    assert axes_doubt(POINTS[:20], CAMERA_FROM_LIDAR) is None

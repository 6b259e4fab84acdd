"""Poses and the frames and meshes that stand at them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sightline.simulation.scene import Material, Pose, world_from_footprint
from sightline.simulation.shapes.primitives import Finish, box


def test_convention_pitch_lowers_the_nose_and_roll_raises_the_left_side():
    nose = world_from_footprint(Pose(x=0.0, y=0.0, z=0.0, yaw=0.0, pitch=0.1), 0.0)[:3, 0]
    assert nose == pytest.approx([np.cos(0.1), 0.0, -np.sin(0.1)])
    left = world_from_footprint(Pose(x=0.0, y=0.0, z=0.0, yaw=0.0, roll=0.1), 0.0)[:3, 1]
    assert left == pytest.approx([0.0, np.cos(0.1), np.sin(0.1)])


def test_a_frame_turns_first_by_roll_then_pitch_then_yaw_and_stands_along_its_own_axis():
    pose = Pose(x=3.0, y=-2.0, z=1.0, yaw=2.1, pitch=0.2, roll=-0.3)
    frame = world_from_footprint(pose, 1.7)
    rotation = Rotation.from_euler("ZYX", [2.1, 0.2, -0.3]).as_matrix()
    np.testing.assert_allclose(frame[:3, :3], rotation, atol=1e-12)
    np.testing.assert_allclose(frame[:3, 3], [3.0, -2.0, 1.0] + 1.7 * rotation[:, 2], atol=1e-12)


def test_a_mesh_is_placed_by_the_frame_of_its_pose():
    mesh = box((0.5, 0.0, 0.5), (0.5, 0.25, 0.5), Finish(Material.PLASTER, (0.5, 0.5, 0.5)))
    pose = Pose(x=10.0, y=5.0, z=-1.0, yaw=0.7, pitch=0.1, roll=0.05)
    frame = world_from_footprint(pose, 0.0)
    placed = mesh.placed(pose)
    expected = mesh.vertices @ frame[:3, :3].T + frame[:3, 3]
    np.testing.assert_allclose(placed.vertices, expected, atol=1e-5)
    np.testing.assert_allclose(placed.normals, mesh.normals @ frame[:3, :3].T, atol=1e-6)
    assert placed.faces is mesh.faces

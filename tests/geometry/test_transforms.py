import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.geometry.transforms import (
    rigid_inverse,
    rigid_transform,
    transform_points,
    wrap_angle,
    yaw_rotation,
)

angles = st.floats(-100, 100)
coordinates = st.floats(-1e4, 1e4)


def random_transform(yaw, x, y, z):
    rotation = yaw_rotation(torch.tensor(yaw, dtype=torch.float64))
    return rigid_transform(rotation, torch.tensor([x, y, z], dtype=torch.float64))


@given(yaw=angles, x=coordinates, y=coordinates, z=coordinates)
def test_a_transform_and_its_inverse_cancel_even_ten_kilometres_away(yaw, x, y, z):
    map_from_lidar = random_transform(yaw, x, y, z)
    identity = rigid_inverse(map_from_lidar) @ map_from_lidar
    torch.testing.assert_close(identity, torch.eye(4).double(), rtol=0, atol=1e-10)


def test_points_move_by_rotation_then_translation():
    map_from_lidar = random_transform(math.pi / 2, 10.0, 0.0, 1.0)
    moved = transform_points(map_from_lidar, torch.tensor([[1.0, 0.0, 0.0]], dtype=torch.float64))
    torch.testing.assert_close(moved, torch.tensor([[10.0, 1.0, 1.0]], dtype=torch.float64))


def test_one_transform_serves_a_batch_of_sweeps():
    lidar_from_camera = random_transform(0.3, 1.0, 2.0, 3.0)
    sweeps = torch.rand(2, 5, 3)
    both = transform_points(lidar_from_camera, sweeps)
    torch.testing.assert_close(both[1], transform_points(lidar_from_camera, sweeps[1]))
    assert both.dtype == torch.float32


@given(angle=st.floats(-1e3, 1e3))
def test_a_wrapped_angle_is_in_range_and_points_the_same_way(angle):
    wrapped = wrap_angle(torch.tensor(angle, dtype=torch.float64)).item()
    assert -math.pi <= wrapped < math.pi
    assert math.cos(wrapped) == pytest.approx(math.cos(angle), abs=1e-9)
    assert math.sin(wrapped) == pytest.approx(math.sin(angle), abs=1e-9)


def test_convention_angles_wrap_to_minus_pi_and_never_to_pi():
    just_below = torch.tensor([math.pi, -math.pi, math.nextafter(-math.pi, -4)]).double()
    assert (wrap_angle(just_below) < math.pi).all()
    assert (wrap_angle(just_below.float()) >= -math.pi).all()


def test_convention_yaw_turns_x_towards_y():
    turned = yaw_rotation(torch.tensor(math.pi / 2)) @ torch.tensor([1.0, 0.0, 0.0])
    torch.testing.assert_close(turned, torch.tensor([0.0, 1.0, 0.0]))

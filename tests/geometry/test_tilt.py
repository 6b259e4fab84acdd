import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sightline.geometry.tilt import Tilt, level_ahead

angles = st.floats(-40, 40)
CAMERA_FROM_LIDAR = np.array([[0.0, -1, 0, 0.1], [0, 0, -1, -0.4], [1, 0, 0, -0.3], [0, 0, 0, 1]])


@given(roll_deg=angles, pitch_deg=angles)
def test_a_tilt_is_the_roll_and_pitch_of_a_urdf(roll_deg, pitch_deg):
    tilt = Tilt(roll_deg=roll_deg, pitch_deg=pitch_deg)
    expected = Rotation.from_euler("xyz", (roll_deg, pitch_deg, 0), degrees=True).as_matrix()
    np.testing.assert_allclose(tilt.level_from_lidar[:3, :3], expected, atol=1e-12)
    assert abs(tilt.level_from_lidar[1, 0]) < 1e-12  # x keeps its bearing
    again = Tilt.from_up(3 * tilt.up)
    assert (again.roll_deg, again.pitch_deg) == pytest.approx((roll_deg, pitch_deg), abs=1e-6)


@given(roll_deg=angles, pitch_deg=angles, yaw_deg=st.floats(-180, 180))
def test_in_the_level_frame_z_is_up_and_x_points_along_the_view(roll_deg, pitch_deg, yaw_deg):
    tilt = Tilt(roll_deg=roll_deg, pitch_deg=pitch_deg)
    assume(not tilt.is_level)
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_euler("z", yaw_deg, degrees=True).as_matrix()
    mounted = CAMERA_FROM_LIDAR @ turn @ tilt.level_from_lidar
    camera_from_level = mounted @ np.linalg.inv(level_ahead(mounted, tilt))
    np.testing.assert_allclose(camera_from_level[1, :3], (0, 0, -1), atol=1e-9)
    assert camera_from_level[2, 0] > np.cos(np.radians(5.01))


def test_a_level_lidar_that_looks_ahead_has_no_other_frame():
    for tilt in (None, Tilt(roll_deg=0.0, pitch_deg=0.0), Tilt(roll_deg=-0.04, pitch_deg=0.04)):
        assert level_ahead(CAMERA_FROM_LIDAR, tilt) is None
    assert level_ahead(CAMERA_FROM_LIDAR, Tilt(roll_deg=0.0, pitch_deg=0.06)) is not None


def test_a_tilt_is_said_in_words():
    assert str(Tilt(roll_deg=-3.0, pitch_deg=12.0)) == (
        "12.0 degrees nose down (pitch) and 3.0 degrees to the left (roll)"
    )

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sightline.data.importing.frames import find_transform, rigid_from_quaternion, turn_ahead
from tests.data.recordings import CAMERA_FROM_LIDAR


def random_rigid(rng):
    rigid = np.eye(4)
    rigid[:3, :3] = Rotation.random(random_state=rng).as_matrix()
    rigid[:3, 3] = rng.normal(size=3)
    return rigid


def test_a_way_through_several_frames_is_the_product_of_its_steps_either_way():
    rng = np.random.default_rng(0)
    a_from_b, b_from_c, b_from_d = (random_rigid(rng) for _ in range(3))
    known = {("a", "b"): a_from_b, ("b", "c"): b_from_c, ("b", "d"): b_from_d}
    np.testing.assert_allclose(find_transform(known, "a", "c"), a_from_b @ b_from_c, atol=1e-12)
    expected = np.linalg.inv(b_from_c) @ b_from_d
    np.testing.assert_allclose(find_transform(known, "c", "d"), expected, atol=1e-12)
    np.testing.assert_array_equal(find_transform(known, "a", "a"), np.eye(4))
    assert find_transform(known, "a", "elsewhere") is None


@pytest.mark.parametrize("yaw_deg", [-150, -90, -45, 45, 90, 180])
def test_a_lidar_frame_is_turned_until_x_points_where_the_camera_looks(yaw_deg):
    aside = np.eye(4)
    aside[:3, :3] = Rotation.from_euler("z", yaw_deg, degrees=True).as_matrix()
    new_from_old, angle_deg = turn_ahead(CAMERA_FROM_LIDAR @ aside.T)
    assert (angle_deg - yaw_deg + 180) % 360 == pytest.approx(180, abs=1e-6)
    camera_from_new = CAMERA_FROM_LIDAR @ aside.T @ np.linalg.inv(new_from_old)
    np.testing.assert_allclose(camera_from_new[2, :2], (1, 0), atol=1e-9)
    np.testing.assert_array_equal(new_from_old[2], (0, 0, 1, 0))


def test_what_looks_ahead_or_stands_on_its_head_is_left_alone():
    for rigid in (CAMERA_FROM_LIDAR, np.diag([-1.0, -1, 1, 1]) @ CAMERA_FROM_LIDAR, np.eye(4)):
        new_from_old, angle_deg = turn_ahead(rigid)
        assert angle_deg == 0
        np.testing.assert_array_equal(new_from_old, np.eye(4))


def test_a_transform_that_is_not_finite_is_refused():
    with pytest.raises(ValueError, match="NaN or infinite values; calibrate again"):
        rigid_from_quaternion(np.array([0.0, 0, 0, 1]), np.array([np.nan, 0, 0]))
    with pytest.raises(ValueError, match="the quaternion 0 0 0 0, which is no rotation"):
        rigid_from_quaternion(np.zeros(4), np.zeros(3))

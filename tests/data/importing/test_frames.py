import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sightline.data.importing.frames import find_transform, rigid_from_quaternion


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


def test_a_transform_that_is_not_finite_is_refused():
    with pytest.raises(ValueError, match="NaN or infinite values; calibrate again"):
        rigid_from_quaternion(np.array([0.0, 0, 0, 1]), np.array([np.nan, 0, 0]))
    with pytest.raises(ValueError, match="the quaternion 0 0 0 0, which is no rotation"):
        rigid_from_quaternion(np.zeros(4), np.zeros(3))

import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sightline.geometry.mount import mount_doubt, off_centre_doubt, resolution_doubt, turn_ahead

NOMINAL = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])
TILTS_DEG = ((0.0, 0.0, 0.0), (0.4, -0.8, 0.2), (1.0, 3.0, -2.0), (-1.0, -6.0, 4.0))
ORDERS = ("xyz", "zyx", "XYZ", "ZYX")


def mounted(rotation, offset=(0.1, -0.4, -0.3)):
    rigid = np.eye(4)
    rigid[:3, :3] = rotation
    rigid[:3, 3] = offset
    return rigid


@pytest.fixture(params=TILTS_DEG, ids=str)
def rigid(request):
    return mounted(NOMINAL @ Rotation.from_euler("xyz", request.param, degrees=True).as_matrix())


angle_deg = st.floats(-9, 9)


@given(roll=angle_deg, pitch=angle_deg, yaw=st.floats(-14, 14))
def test_a_camera_that_looks_ahead_is_not_doubted(roll, pitch, yaw):
    tilt = Rotation.from_euler("xyz", (roll, pitch, yaw), degrees=True).as_matrix()
    assert mount_doubt(mounted(NOMINAL @ tilt)) is None


def test_an_inverse_is_named(rigid):
    assert mount_doubt(np.linalg.inv(rigid)).startswith("is probably inverted")


def test_the_identity_is_named(rigid):
    assert mount_doubt(np.eye(4)).startswith("has the identity for its rotation")
    assert mount_doubt(mounted(np.eye(3), rigid[:3, 3])).startswith("has the identity")


@pytest.mark.parametrize(
    ("axes", "message"),
    [
        (np.diag([1.0, -1, -1]), "x, y, z point right, up, backward"),  # OpenGL's camera
        (np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]]), "x, y, z point down, forward, right"),
        (np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), "x, y, z point right, backward, down"),
    ],
)
def test_a_camera_whose_axes_are_swapped_is_told_where_they_point(rigid, axes, message):
    doubt = mount_doubt(mounted(axes @ rigid[:3, :3]))
    assert doubt.startswith("has its axes swapped")
    assert message in doubt
    assert "convert both, points and transform" in doubt


def test_a_camera_that_looks_aside_is_not_doubted(rigid):
    for yaw_deg in (20, -50, 90, 179):
        turn = Rotation.from_euler("z", yaw_deg, degrees=True).as_matrix()
        assert mount_doubt(mounted(rigid[:3, :3] @ turn)) is None


@pytest.mark.parametrize("order", ORDERS)
def test_degrees_for_radians_are_named(rigid, order):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of angles that have more than one solution
        angles_deg = Rotation.from_matrix(rigid[:3, :3]).as_euler(order, degrees=True)
    if abs(abs(angles_deg[1]) - 90) < 10:
        pytest.skip("in this order the angles of such a mount have more than one solution")
    doubt = mount_doubt(mounted(Rotation.from_euler(order, angles_deg).as_matrix()))
    assert "its angles are probably in degrees where radians were expected" in doubt


@pytest.mark.parametrize("order", ORDERS)
def test_radians_for_degrees_are_named(rigid, order):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        angles_rad = Rotation.from_matrix(rigid[:3, :3]).as_euler(order)
    doubt = mount_doubt(mounted(Rotation.from_euler(order, angles_rad, degrees=True).as_matrix()))
    assert "(ROS: camera_link), or angles in degrees if they are in radians" in doubt


def test_an_offset_in_millimetres_is_named(rigid):
    rigid[:3, 3] *= 1000
    assert "its last column is probably in millimetres; give metres" in mount_doubt(rigid)


def test_an_offset_that_may_be_in_centimetres_is_called_so(rigid):
    rigid[:3, 3] *= 100
    doubt = mount_doubt(rigid)
    assert "is probably in millimetres or centimetres; give metres" in doubt
    assert doubt.endswith(
        "or if points are in a map's or world's frame, both in the LiDAR's own frame"
    )


def test_a_lidar_that_may_be_upside_down_is_named(rigid):
    over = Rotation.from_euler("xz", (180, 140), degrees=True).as_matrix()
    rigid[:3, :3] = rigid[:3, :3] @ over.T
    assert "if the LiDAR is upside down or on its side, convert both" in mount_doubt(rigid)


@pytest.mark.parametrize("factor", [0.25, 0.5, 1.5, 2.0])
def test_a_camera_matrix_of_another_resolution_is_told(factor):
    camera = np.array([[1100.0, 0, 959.5], [0, 1100.0, 599.5], [0, 0, 1]])
    scaled = np.diag([factor, factor, 1]) @ camera
    resolution = resolution_doubt(scaled, (1200, 1920))
    assert resolution is not None
    assert "but images are 1200x1920" in resolution
    assert "it is for another resolution" in resolution


def test_height_and_width_that_were_swapped_are_told():
    camera = np.array([[721.5, 0, 609.6], [0, 721.5, 172.9], [0, 0, 1]])
    assert "height and width are probably swapped" in resolution_doubt(camera, (1242, 375))
    assert resolution_doubt(camera, (375, 1242)) is None
    nearly_square = np.array([[500.0, 0, 265.0], [0, 500.0, 290.0], [0, 0, 1]])
    assert resolution_doubt(nearly_square, (480, 640)) is None


def test_a_camera_that_was_cropped_is_not_doubted():
    for principal, size in [((959.5, 599.5), (1200, 1920)), ((609.6, 172.9), (375, 1242))]:
        camera = np.array([[700.0, 0, principal[0]], [0, 700.0, principal[1]], [0, 0, 1]])
        assert resolution_doubt(camera, size) is None
    camera = np.array([[700.0, 0, 959.5], [0, 700.0, 100.0], [0, 0, 1]])  # half of it cut off
    assert resolution_doubt(camera, (700, 1920)) is None


@pytest.mark.parametrize("yaw_deg", [-150, -90, -45, -6, 10, 45, 90, 180])
def test_a_lidar_frame_is_turned_until_x_points_where_the_camera_looks(yaw_deg):
    aside = np.eye(4)
    aside[:3, :3] = Rotation.from_euler("z", yaw_deg, degrees=True).as_matrix()
    new_from_old, angle_deg = turn_ahead(mounted(NOMINAL) @ aside.T)
    assert (angle_deg - yaw_deg + 180) % 360 == pytest.approx(180, abs=1e-6)
    camera_from_new = mounted(NOMINAL) @ aside.T @ np.linalg.inv(new_from_old)
    np.testing.assert_allclose(camera_from_new[2, :2], (1, 0), atol=1e-9)
    np.testing.assert_array_equal(new_from_old[2], (0, 0, 1, 0))


def test_what_looks_ahead_or_stands_on_its_head_is_left_alone():
    for rigid in (mounted(NOMINAL), np.diag([-1.0, -1, 1, 1]) @ mounted(NOMINAL), np.eye(4)):
        new_from_old, angle_deg = turn_ahead(rigid)
        assert angle_deg == 0
        np.testing.assert_array_equal(new_from_old, np.eye(4))


@pytest.mark.parametrize(
    ("x_px", "y_px", "is_told"),
    [(620, 190, False), (250, 190, True), (620, 340, True), (400, 50, True), (1000, 50, True)],
)
def test_a_principal_point_far_from_the_centre_is_told(x_px, y_px, is_told):
    camera = np.array([[720.0, 0, x_px], [0, 720.0, y_px], [0, 0, 1]])
    assert (off_centre_doubt(camera, (375, 1242)) is not None) == is_told


@pytest.mark.parametrize(
    ("focal_px", "principal_px", "size"),
    [
        (721.5, (308.6, -10.1), (192, 640)),  # only the road is in view
        (720.0, (620.0, 50.0), (375, 1242)),
        (721.5, (949.0, 878.0), (1080, 1920)),  # most of it is sky
    ],
)
def test_a_crop_or_an_extension_at_the_top_is_not_doubted(focal_px, principal_px, size):
    x, y = principal_px
    camera = np.array([[focal_px, 0, x], [0, focal_px, y], [0, 0, 1]])
    assert off_centre_doubt(camera, size) is None


@pytest.mark.parametrize("size", [(500, 1920), (640, 640), (480, 640), (600, 800), (1080, 800)])
def test_images_cropped_or_resized_without_their_matrix_are_told(size):
    camera = np.array([[1100.0, 0, 959.5], [0, 1100.0, 539.5], [0, 0, 1]])  # of 1080 x 1920
    assert resolution_doubt(camera, size) or off_centre_doubt(camera, size)

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.geometry.calibration import Calibration
from sightline.geometry.projection import (
    dhi_image,
    project_points,
    sparse_depth_map,
    unproject_pixels,
)
from tests.geometry.cameras import CAMERA_FROM_LIDAR, IMAGE_FROM_CAMERA, kitti_like_calibration
from tests.reference import geometry as reference

KITTI_SIZE = (375, 1242)
# A tiny camera (focal length 4 px, 6 x 8 image), so that many points share few pixels.
TINY_IMAGE_FROM_CAMERA = [[4.0, 0.0, 3.6, 0.1], [0.0, 4.0, 2.4, 0.0], [0.0, 0.0, 1.0, 0.01]]
points_near = st.tuples(st.floats(-5, 30), st.floats(-9, 9), st.floats(-5, 5), st.just(0.5))


def tiny_calibration():
    return Calibration(
        image_from_camera=torch.tensor(TINY_IMAGE_FROM_CAMERA, dtype=torch.float64),
        camera_from_lidar=torch.tensor(CAMERA_FROM_LIDAR, dtype=torch.float64),
    )


@given(x=st.floats(0.5, 100), y=st.floats(-50, 50), z=st.floats(-5, 5))
def test_projection_equals_the_reference(x, y, z):
    projected = project_points(
        torch.tensor([[x, y, z]], dtype=torch.float64), kitti_like_calibration()
    )
    expected = reference.project((x, y, z), IMAGE_FROM_CAMERA, CAMERA_FROM_LIDAR)
    assert [*projected.pixels[0].tolist(), projected.depths[0].item()] == pytest.approx(expected)


def test_points_behind_the_camera_have_no_pixel():
    projected = project_points(torch.tensor([[-5.0, 0.0, 0.0]]), kitti_like_calibration())
    assert projected.pixels.isnan().all()
    assert projected.depths.item() < 0
    assert not projected.in_image(KITTI_SIZE).item()


@given(points=st.lists(points_near, max_size=30))
def test_the_sparse_map_keeps_the_nearest_point_of_each_pixel(points):
    sweep = torch.tensor(points, dtype=torch.float64).reshape(-1, 4)
    depth = sparse_depth_map(sweep, tiny_calibration(), (6, 8))
    expected = reference.sparse_depth_map(points, TINY_IMAGE_FROM_CAMERA, CAMERA_FROM_LIDAR, 6, 8)
    torch.testing.assert_close(depth, torch.tensor(expected))


def test_an_empty_sweep_gives_an_empty_map():
    assert not sparse_depth_map(torch.zeros(0, 4), kitti_like_calibration(), (4, 5)).any()
    assert not dhi_image(torch.zeros(0, 4), kitti_like_calibration(), (4, 5)).any()


def test_pixels_with_depth_go_back_to_their_points_in_a_batch():
    points = torch.rand(3, 50, 3, dtype=torch.float64) * 40 + torch.tensor([1.0, -20, -2]).double()
    projected = project_points(points, kitti_like_calibration())
    back = unproject_pixels(projected.pixels, projected.depths, kitti_like_calibration())
    torch.testing.assert_close(back, points, rtol=0, atol=1e-9)


def test_projection_keeps_its_digits_ten_kilometres_away():
    far = torch.tensor([[1e4, 3000.0, 100.0]], dtype=torch.float64)
    projected = project_points(far, kitti_like_calibration())
    back = unproject_pixels(projected.pixels, projected.depths, kitti_like_calibration())
    torch.testing.assert_close(back, far, rtol=0, atol=1e-7)


def test_convention_pixel_zero_is_the_centre_of_the_top_left_pixel():
    edge = torch.tensor([[-0.49, -0.49], [-0.51, 0.0], [1241.49, 374.49], [1241.51, 0.0]])
    points = unproject_pixels(edge.double(), torch.full((4,), 10.0), kitti_like_calibration())
    inside = project_points(points, kitti_like_calibration()).in_image(KITTI_SIZE)
    assert inside.tolist() == [True, False, True, False]


def test_the_dhi_image_follows_equations_1_to_3():
    point = torch.tensor([[20.0, 0.0, -0.23, 0.35]])  # 1.5 m above the road
    image = dhi_image(point, kitti_like_calibration(), KITTI_SIZE)
    found = image[:, image.any(dim=0)][:, 0]
    assert found.tolist() == pytest.approx([255 * 0.75, 255 * 0.75, 255 * 0.5], abs=1e-3)


def test_the_literal_dhi_image_takes_height_as_the_sweep_gives_it():
    point = torch.tensor([[20.0, 0.0, 3.0, 0.35]])
    image = dhi_image(point, kitti_like_calibration(), KITTI_SIZE, height_offset_m=0.0)
    assert image[1].max().item() == pytest.approx(255 * 0.5, abs=1e-3)


def test_the_nearest_point_gives_all_three_dhi_channels_of_its_pixel():
    along_one_ray = torch.tensor([[40.0, 0.0, 0.0, 0.7], [20.0, 0.0, 0.0, 0.0]])
    calibration = Calibration(
        image_from_camera=torch.tensor(IMAGE_FROM_CAMERA, dtype=torch.float64),
        camera_from_lidar=torch.tensor(
            [[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]], dtype=torch.float64
        ),
    )
    image = dhi_image(along_one_ray, calibration, KITTI_SIZE)
    nearest = image[0].argmax()
    assert image[0].flatten()[nearest].item() == pytest.approx(255 * 0.75)
    assert image[2].flatten()[nearest].item() == pytest.approx(255)


def test_clouds_by_columns_and_sizes_that_no_image_has_are_refused():
    calibration = kitti_like_calibration()
    with pytest.raises(
        ValueError, match=r"shape \(4, 2\), expected num_points, 3 or more; give one r"
    ):
        sparse_depth_map(torch.zeros(4, 2), calibration, KITTI_SIZE)
    with pytest.raises(ValueError, match=r"\(3, 50\), expected .*: points\.mT"):
        sparse_depth_map(torch.ones(3, 50), calibration, KITTI_SIZE)
    with pytest.raises(ValueError, match=r"image_size is \(0, 5\), expected"):
        sparse_depth_map(torch.zeros(9, 4), calibration, (0, 5))

import pytest
import torch

from sightline.geometry.calibration import Calibration
from sightline.geometry.projection import project_points
from tests.geometry.cameras import CAMERA_FROM_LIDAR, IMAGE_FROM_CAMERA, kitti_like_calibration


def calibration(image_from_camera=IMAGE_FROM_CAMERA, camera_from_lidar=CAMERA_FROM_LIDAR):
    return Calibration(
        image_from_camera=torch.tensor(image_from_camera, dtype=torch.float64),
        camera_from_lidar=torch.tensor(camera_from_lidar, dtype=torch.float64),
    )


def test_a_singular_projection_is_refused():
    with pytest.raises(ValueError, match=r"camera matrix \(image_from_camera\) is sing"):
        calibration(image_from_camera=[[0.0] * 4, *IMAGE_FROM_CAMERA[1:]])


def test_a_mount_that_scales_is_no_rotation_and_refused():
    stretched = [[2 * value for value in CAMERA_FROM_LIDAR[0]], *CAMERA_FROM_LIDAR[1:]]
    with pytest.raises(ValueError, match="camera_from_lidar holds no rotation: its rows"):
        calibration(camera_from_lidar=stretched)


def test_a_mirrored_mount_is_refused():
    mirrored = [[-value for value in CAMERA_FROM_LIDAR[0]], *CAMERA_FROM_LIDAR[1:]]
    with pytest.raises(ValueError, match=r"it mirrors, as from a left-handed .* in the points"):
        calibration(camera_from_lidar=mirrored)


def test_a_mount_that_is_no_rigid_transform_is_refused():
    with pytest.raises(ValueError, match="last row of camera_from_lidar is not 0 0 0 1"):
        calibration(camera_from_lidar=[*CAMERA_FROM_LIDAR[:3], [0.0, 0.0, 0.0, 2.0]])


def test_values_that_are_not_finite_are_refused():
    with pytest.raises(ValueError, match="image_from_camera holds NaN"):
        calibration(image_from_camera=[[float("nan")] * 4, *IMAGE_FROM_CAMERA[1:]])


def test_after_a_crop_every_point_moves_by_the_cut():
    points = torch.tensor([[10.0, 1.0, -1.0], [30.0, -5.0, 0.0]], dtype=torch.float64)
    whole = project_points(points, kitti_like_calibration())
    cut = project_points(points, kitti_like_calibration().crop(13, 23))
    torch.testing.assert_close(cut.pixels, whole.pixels - torch.tensor([13.0, 23.0]).double())
    torch.testing.assert_close(cut.depths, whole.depths)


def test_convention_resizing_maps_pixel_edges_onto_pixel_edges():
    point = torch.tensor([[10.0, 1.0, -1.0]], dtype=torch.float64)
    whole = project_points(point, kitti_like_calibration()).pixels
    half = project_points(point, kitti_like_calibration().resize(0.5, 0.25)).pixels
    edge_scale = torch.tensor([0.5, 0.25]).double()
    torch.testing.assert_close(half + 0.5, (whole + 0.5) * edge_scale)

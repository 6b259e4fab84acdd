import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sightline.data.calibration_text import read_object_matrices
from sightline.data.image_header import read_image_size
from sightline.data.velodyne import read_sweep
from sightline.data.view import is_in_view

SIZE = (6, 9)
# Looks along x with a focal length of one pixel: the pixel of (d, left, up) is (-left, -up) / d.
IMAGE_FROM_LIDAR = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0]])
halves = st.integers(-6, 24).map(lambda number: number / 2)


@given(x=halves, y=halves, depth_m=st.sampled_from([-2.0, 0.0, 0.5, 2.0]))
def test_the_cut_begins_at_the_first_pixels_centre_and_ends_below_width_and_height(x, y, depth_m):
    point = np.array([[depth_m, -x * depth_m, -y * depth_m, 0.5]], np.float32)
    expected = depth_m > 0 and 0 <= x < 9 and 0 <= y < 6
    assert is_in_view(point, IMAGE_FROM_LIDAR, SIZE).tolist() == [expected]


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_points_that_are_not_finite_and_none_at_all_are_not_in_view(value):
    points = np.full((2, 4), value, np.float32)
    with np.errstate(invalid="ignore"):
        assert is_in_view(points, IMAGE_FROM_LIDAR, SIZE).tolist() == [False, False]
    assert is_in_view(points[:0], IMAGE_FROM_LIDAR, SIZE).tolist() == []


def test_kittis_reduced_sweeps_are_its_whole_ones_so_cut_to_the_last_point(kitti_root):
    whole = sorted(kitti_root.glob("full_sweeps/*.bin"))
    assert len(whole) == 6
    for path in whole:
        points = read_sweep(path)
        training = kitti_root / "training"
        matrices = read_object_matrices(training / "calib" / f"{path.stem}.txt")
        projection = matrices.image_from_camera @ matrices.camera_from_lidar
        size = read_image_size(training / "image_2" / f"{path.stem}.png")
        kept = points[is_in_view(points, projection, size)]
        assert np.array_equal(kept, read_sweep(training / "velodyne" / path.name))

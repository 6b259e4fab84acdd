import math
import subprocess
import sys

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from sightline.augmentation.sample_changes import points_in_view
from sightline.data.formats import pixels
from sightline.data.formats.image_header import read_image_size
from sightline.data.formats.kitti_calibration import read_object_matrices
from sightline.data.formats.pixels import is_in_view
from sightline.data.formats.velodyne import read_sweep
from sightline.geometry import projection, transforms
from sightline.geometry.calibration import Calibration
from sightline.simulation.settings import SimulationConfig
from sightline.simulation.simulator import calibration_of
from sightline.structures.sample import CameraLidarSample

SIZE = (6, 9)
# Looks along x with a focal length of one pixel: the pixel of (d, left, up) is (-left, -up) / d.
IMAGE_FROM_LIDAR = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0]])
halves = st.integers(-6, 24).map(lambda number: number / 2)
CONFIGS = st.builds(
    SimulationConfig,
    image_size=st.tuples(st.integers(32, 400), st.integers(32, 1300)),
    focal_px=st.floats(100.0, 1500.0),
)
POINTS = arrays(
    np.float32, st.tuples(st.integers(0, 40), st.just(4)), elements=st.floats(-50, 50, width=32)
)


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


def as_tensors(config: SimulationConfig) -> Calibration:
    matrices = calibration_of(config)
    return Calibration(
        image_from_camera=torch.from_numpy(matrices.image_from_camera),
        camera_from_lidar=torch.from_numpy(matrices.camera_from_lidar),
    )


@given(config=CONFIGS)
@settings(max_examples=30, deadline=None)
def test_a_calibration_is_resized_and_cropped_as_by_the_project_s_own(config: SimulationConfig):
    kitti = SimulationConfig()
    scale = config.focal_px / kitti.focal_px
    height, width = (scale * size for size in kitti.image_size)
    expected = as_tensors(kitti).resize(scale, scale)
    expected = expected.crop(
        round((width - config.image_size[1]) / 2), round(height - config.image_size[0])
    )
    made = as_tensors(config)
    assert torch.allclose(made.image_from_camera, expected.image_from_camera, rtol=1e-14)
    assert np.allclose(
        pixels.image_from_lidar(calibration_of(config)), expected.image_from_lidar, rtol=1e-13
    )


@given(points=POINTS, config=CONFIGS)
@settings(max_examples=50, deadline=None)
def test_a_sweep_falls_where_the_project_s_own_projection_says(
    points: np.ndarray, config: SimulationConfig
):
    sweep, calibration = torch.from_numpy(points), as_tensors(config)
    sparse = pixels.sparse_depth_map(points, calibration_of(config), config.image_size)
    wanted = projection.sparse_depth_map(sweep, calibration, config.image_size).numpy()
    assert np.allclose(sparse, wanted, rtol=1e-6)


@given(points=POINTS, config=CONFIGS)
@settings(max_examples=50, deadline=None)
def test_the_camera_sees_what_kittis_reduced_sweeps_keep(
    points: np.ndarray, config: SimulationConfig
):
    seen = pixels.crop_to_view(points, calibration_of(config), config.image_size)
    sample = CameraLidarSample(
        sample_id="seen",
        calibration=as_tensors(config),
        image_size=config.image_size,
        points=torch.from_numpy(points),
    )
    assert np.array_equal(seen, points[points_in_view(sample).numpy()])


def test_pixels_with_a_depth_are_found_again_from_their_points():
    config = SimulationConfig()
    rng = np.random.default_rng(0)
    places, depths = rng.uniform(0, 1000, (50, 2)), rng.uniform(1, 80, 50)
    points = pixels.unproject_pixels(places, depths, calibration_of(config))
    expected = projection.unproject_pixels(
        torch.from_numpy(places), torch.from_numpy(depths), as_tensors(config)
    )
    assert np.allclose(points, expected.numpy(), atol=1e-10)


@given(angles=arrays(np.float64, 20, elements=st.floats(-20, 20)))
@settings(deadline=None)
def test_angles_are_wrapped_as_by_the_project_s_own(angles: np.ndarray):
    limits = [-math.pi, math.pi, math.nextafter(-math.pi, -4)]
    angles = np.concatenate((angles, limits))
    wrapped = pixels.wrap_angle(angles)
    assert np.array_equal(wrapped, transforms.wrap_angle(torch.from_numpy(angles)).numpy())


def test_simulating_needs_no_pytorch_which_would_fill_every_worker():
    program = "import sys, sightline.simulation.generate; sys.exit('torch' in sys.modules)"
    subprocess.run([sys.executable, "-c", program], check=True)

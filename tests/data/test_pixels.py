import math
import subprocess
import sys

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from sightline.augmentation.sample_changes import points_in_view
from sightline.data import pixels
from sightline.geometry import projection, transforms
from sightline.geometry.calibration import Calibration
from sightline.simulation.settings import SimulationConfig
from sightline.simulation.simulator import calibration_of
from sightline.structures.sample import CameraLidarSample

CONFIGS = st.builds(
    SimulationConfig,
    image_size=st.tuples(st.integers(32, 400), st.integers(32, 1300)),
    focal_px=st.floats(100.0, 1500.0),
)
POINTS = arrays(
    np.float32, st.tuples(st.integers(0, 40), st.just(4)), elements=st.floats(-50, 50, width=32)
)


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

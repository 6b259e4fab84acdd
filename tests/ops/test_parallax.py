import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

import sightline
from sightline.geometry.calibration import Calibration
from sightline.geometry.projection import project_points, sparse_depth_map
from sightline.ops.parallax import Parallax, hidden_by_parallax
from sightline.simulation.packaged import PACKAGED_FRAMES
from tests.reference import parallax as reference

offsets = st.floats(-2, 2)


@given(st.tuples(offsets, offsets, offsets), st.integers(0, 2**31))
def test_points_of_one_lidar_ray_lie_apart_by_the_difference_of_their_inverse_depths(place, seed):
    rng = np.random.default_rng(seed)
    camera_from_lidar = np.array(
        [[0, -1, 0, place[0]], [0, 0, -1, place[1]], [1, 0, 0, place[2]], [0, 0, 0, 1]], float
    )
    projection = np.array([[700, 0, 610, 45], [0, 710, 170, -0.3], [0, 0, 1, 0.005]], float)
    calibration = Calibration(
        image_from_camera=torch.from_numpy(projection),
        camera_from_lidar=torch.from_numpy(camera_from_lidar),
    )
    direction = np.array([1.0, rng.uniform(-0.5, 0.5), rng.uniform(-0.2, 0.2)])
    points = torch.from_numpy(np.stack([direction * rng.uniform(4, 80) for _ in range(2)]))
    far, near = project_points(points, calibration).pixels.numpy()
    far_m, near_m = project_points(points, calibration).depths.tolist()
    parallax = Parallax.from_calibration(calibration)
    scale = 1 + parallax.growth_m / far_m
    shift = (np.array(parallax.base_px_m) + parallax.growth_m * far) / scale
    np.testing.assert_allclose(near - far, shift * (1 / near_m - 1 / far_m), atol=1e-6)


@given(st.integers(0, 2**31), st.floats(-200, 200), st.floats(-200, 200), st.floats(-1, 1))
def test_a_return_is_hidden_as_loops_over_all_pairs_say(seed, base_x, base_y, growth):
    rng = np.random.default_rng(seed)
    shape = (int(rng.integers(1, 20)), int(rng.integers(1, 24)))
    depth = rng.uniform(3, 60, shape).astype(np.float32)
    sweep = np.where(rng.random(shape) < 0.15, depth, np.float32(0))
    pixels = np.argwhere(sweep > 0)
    parallax = Parallax(base_px_m=(base_x, base_y), growth_m=growth)
    hidden = hidden_by_parallax(sweep, pixels, sweep[*pixels.T], parallax)
    expected = [
        reference.hides(sweep.tolist(), y, x, float(sweep[y, x]), (base_x, base_y), growth)
        for y, x in pixels.tolist()
    ]
    assert hidden.tolist() == expected


def test_nothing_is_hidden_from_a_camera_in_the_lidars_place():
    sweep = np.zeros((20, 20), np.float32)
    sweep[::2] = 5.0
    sweep[10, 10] = 40.0
    pixels = np.array([[10, 10]])
    here = Parallax(base_px_m=(0.0, 0.0), growth_m=0.0)
    assert not hidden_by_parallax(sweep, pixels, sweep[10, 10:11], here).any()


@pytest.mark.parametrize("index", [0, 1])
def test_on_simulated_frames_it_finds_half_of_the_hidden_returns_and_few_sound_ones(index):
    sample = sightline.open_dataset(PACKAGED_FRAMES, parts={"points", "depth"})[index]
    sweep = sparse_depth_map(sample.points, sample.calibration, sample.image_size).numpy()
    truth, pixels = sample.depth.numpy(), np.argwhere(sweep > 0)
    depths, true = sweep[*pixels.T], truth[*pixels.T]
    hidden = hidden_by_parallax(
        sweep, pixels, depths, Parallax.from_calibration(sample.calibration)
    )
    behind = (true > 0) & (depths - true > np.maximum(1, 0.1 * true))
    sound = (true > 0) & (np.abs(depths - true) < 0.3)
    assert behind.sum() > 100
    assert hidden[behind].mean() > 0.45  # recall
    assert hidden[sound].mean() < 0.015
    far = sound & (depths > 40)
    assert hidden[far].mean() < 0.05

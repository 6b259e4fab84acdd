from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sightline.geometry.cloud_batches import is_batch_of_clouds
from tests.data.recordings import POINTS


def organised(num_rings, num_columns, lowest_deg=-25.0, highest_deg=3.0):
    """A spinning LiDAR's sweep of a street between walls: rings by columns."""
    elevation = np.radians(np.linspace(lowest_deg, highest_deg, num_rings))[:, None]
    azimuth = np.linspace(np.pi, -np.pi, num_columns, endpoint=False)[None]
    wall_m = np.minimum(12 / np.abs(np.sin(azimuth)).clip(1e-3), 60) / np.cos(elevation)
    range_m = np.minimum(wall_m, 1.8 / np.sin(-elevation).clip(1e-3))
    x = range_m * np.cos(elevation) * np.cos(azimuth)
    y = range_m * np.cos(elevation) * np.sin(azimuth)
    cloud = np.stack((x, y, range_m * np.sin(elevation), 0 * range_m + 0.3), axis=-1)
    cloud[np.random.default_rng(2).random(cloud.shape[:2]) < 0.2] = np.nan
    return cloud


CLOUDS = [
    organised(16, 1800),
    organised(64, 2048),
    organised(4, 500, -1.6, 1.6),
    organised(4, 2000, -1.6, 1.6),
    organised(128, 1024),
]


@pytest.mark.parametrize("cloud", CLOUDS, ids=lambda cloud: str(cloud.shape))
def test_an_organised_cloud_is_no_batch(cloud):
    packed = np.full_like(cloud, np.nan)  # without gaps between the points of a ring
    for row, ring in zip(packed, cloud, strict=True):
        echoes = ring[np.isfinite(ring[:, 0])]
        row[: len(echoes)] = echoes
    tilted = cloud.copy()
    tilted[..., :3] @= Rotation.from_euler("xy", (5, 12), degrees=True).as_matrix().T
    moved = cloud + np.array([2, 0, 1.7, 0])
    for each in (cloud, cloud.swapaxes(0, 1), packed, tilted, moved, cloud[None]):
        assert not is_batch_of_clouds(each)


def repeated(cloud, seed):
    """Another sweep on the same rays: noise of 2 cm, and one ray in three hits something else."""
    generator = np.random.default_rng(seed)
    range_m = np.linalg.norm(cloud[..., :3], axis=-1, keepdims=True)
    rise_m = generator.normal(0, 0.02, range_m.shape)
    rise_m += (generator.random(range_m.shape) < 0.3) * generator.uniform(-0.4, 0.4) * range_m
    again = cloud.copy()
    again[..., :3] *= 1 + rise_m / range_m
    again[generator.random(cloud.shape[:2]) < 0.1] = 0
    return again


@pytest.mark.parametrize("num_clouds", [2, 5])
def test_sweeps_of_an_organised_lidar_are_a_batch_also_flattened(num_clouds):
    for cloud in CLOUDS[:2]:
        batch = np.stack([repeated(cloud, seed) for seed in range(num_clouds)])
        assert is_batch_of_clouds(batch)
        assert is_batch_of_clouds(batch.reshape(num_clouds, -1, 4))


@pytest.mark.parametrize("share", [0.05, 0.3, 0.5])
@pytest.mark.parametrize("single", ["repeated", "absent"])
def test_two_returns_of_an_organised_lidar_are_no_batch(share, single):
    generator = np.random.default_rng(3)
    for cloud in CLOUDS[:2]:
        range_m = np.linalg.norm(cloud[..., :3], axis=-1, keepdims=True)
        is_double = generator.random(range_m.shape) < share
        second = cloud.copy()
        second[..., :3] *= 1 + (0.5 + generator.exponential(3, range_m.shape)) / range_m
        second = np.where(is_double, second, cloud if single == "repeated" else 0)
        swapped = generator.random(range_m.shape) < 0.5  # the stronger first
        strongest = np.where(swapped & is_double, second, cloud)
        others = np.where(swapped & is_double, cloud, second)
        for pair in ((cloud, second), (strongest, others)):
            assert not is_batch_of_clouds(np.stack(pair))
            assert not is_batch_of_clouds(np.stack(pair).reshape(2, -1, 4))


@pytest.mark.parametrize("num_parts", [2, 4])
def test_interleaved_columns_or_rings_are_no_batch(num_parts):
    cloud = organised(64, 4096)
    cloud = repeated(cloud, 0)
    for axis in (0, 1):
        parts = [
            cloud.take(range(at, cloud.shape[axis], num_parts), axis) for at in range(num_parts)
        ]
        assert not is_batch_of_clouds(np.stack(parts))


def test_two_returns_of_each_ray_are_no_batch():
    second = POINTS.copy()
    second[::9, :3] *= 1.3
    assert not is_batch_of_clouds(np.stack((POINTS, second)))
    assert not is_batch_of_clouds(np.stack((POINTS, second), axis=1))


def test_parts_of_a_sweep_are_no_batch():
    for cloud in (POINTS, POINTS[np.argsort(np.arctan2(POINTS[:, 1], POINTS[:, 0]))]):
        for num_parts in (2, 4, 10):
            count = len(cloud) // num_parts
            assert not is_batch_of_clouds(cloud[: count * num_parts].reshape(num_parts, count, 4))


@pytest.mark.parametrize("num_clouds", [2, 4, 20])
def test_clouds_one_after_the_other_are_a_batch_also_with_padding(num_clouds):
    generator = np.random.default_rng(0)
    batch = np.zeros((num_clouds, len(POINTS), 4))
    for cloud in batch:
        kept = POINTS[generator.random(len(POINTS)) < generator.uniform(0.7, 0.9)]
        cloud[: len(kept)] = kept
    assert is_batch_of_clouds(batch)
    assert is_batch_of_clouds(np.stack([POINTS] * num_clouds))


def test_the_sweeps_of_kitti_are_a_batch_together_and_not_alone(kitti_root):
    paths = sorted(kitti_root.glob("training/velodyne/*.bin"))[:20]
    sweeps = [np.fromfile(path, np.float32).reshape(-1, 4) for path in paths]
    for first, second in pairwise(sweeps):
        count = min(len(first), len(second))
        assert is_batch_of_clouds(np.stack((first[:count], second[:count])))
        assert not is_batch_of_clouds(first[None])
    images = [range_image(points) for points in sweeps]
    found = [is_batch_of_clouds(np.stack(pair)) for pair in pairwise(images)]
    assert sum(found) >= len(found) - 1
    assert is_batch_of_clouds(np.stack(images).reshape(len(images), -1, 4))


def range_image(points, num_rings=64, num_columns=256):
    """Points of a camera's view by elevation and azimuth; 0: none."""
    x, y, z, _ = points.T
    column = ((0.5 - np.arctan2(y, x) / (np.pi / 2)) * num_columns).astype(int)
    ring = ((3 - np.degrees(np.arctan2(z, np.hypot(x, y)))) / 28 * num_rings).astype(int)
    is_inside = (column >= 0) & (column < num_columns) & (ring >= 0) & (ring < num_rings)
    image = np.zeros((num_rings, num_columns, 4), np.float32)
    image[ring[is_inside], column[is_inside]] = points[is_inside]
    return image

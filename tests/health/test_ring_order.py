from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.augmentation.sample_changes import rotate_extrinsics
from sightline.geometry.calibration import Calibration
from sightline.geometry.tilt import Tilt
from sightline.health.lidar_checks import check_lidar, is_ahead
from sightline.health.monitor import HealthMonitor
from sightline.health.ring_order import level_by_ring, number_rings, ring_by_ring
from sightline.health.sphere import to_sphere
from sightline.health.yaw_error import estimate_yaw, match_edges
from sightline.structures.level import level_sample
from sightline.structures.sample import CameraLidarSample
from tests.health.frames import sound


def origin_lidar(step_deg=1.0):
    """The packaged sweep as lasers of one origin would have taken it, ring by ring."""
    points = sound().points.numpy()
    points = points[is_ahead(points)]
    ranges, azimuth, elevation = to_sphere(points)
    rings = np.rint(elevation / step_deg)
    kept = np.abs(elevation - rings * step_deg) < 0.15
    tilt, turn = np.radians(rings * step_deg), np.radians(azimuth)
    rays = (np.cos(tilt) * np.cos(turn), np.cos(tilt) * np.sin(turn), np.sin(tilt))
    moved = np.stack((*(ranges * each for each in rays), points[:, 3]), axis=1)[kept]
    order = np.lexsort((azimuth[kept], -rings[kept]))
    return moved[order].astype(np.float32)


ORDERS = {
    "as it is": lambda points: points,
    "backwards": lambda points: points[::-1].copy(),
    "by shots": lambda points: points[np.argsort(to_sphere(points)[1], kind="stable")],
    "shuffled": lambda points: np.random.default_rng(0).permutation(points),
}


@pytest.mark.parametrize("order", ORDERS)
def test_sweeps_in_any_order_become_the_same(order):
    points = origin_lidar()
    assert np.array_equal(ring_by_ring(ORDERS[order](points)), points)


@pytest.mark.parametrize("order", ORDERS)
def test_sweeps_in_any_order_are_judged_alike(order):
    points = origin_lidar()
    changed = ORDERS[order](points)
    assert check_lidar(changed) == check_lidar(points)
    first, second = (
        match_edges(replace(sound(), points=torch.from_numpy(each))) for each in (points, changed)
    )
    assert np.array_equal(first.curves, second.curves)
    assert np.array_equal(first.tops.strengths, second.tops.strengths)
    assert first.tops.weights.any()


@pytest.mark.parametrize("order", ["by shots", "shuffled", "column by column"])
def test_a_sweep_of_an_hdl_64e_in_another_order_is_judged_as_in_its_own(order):
    points = sound().points.numpy()
    if order == "column by column":
        _, azimuth, elevation = to_sphere(points)
        changed = points[np.lexsort((-elevation, np.floor(azimuth / 0.5)))]
    else:
        changed = ORDERS[order](points)
    expected, found = check_lidar(points), check_lidar(changed)
    assert 2**-found.ringless == pytest.approx(2**-expected.ringless, abs=1.5)
    np.testing.assert_allclose(found, expected, atol=0.1)


def test_a_sweep_of_lasers_apart_from_each_other_stays_in_its_order():
    points = sound().points.numpy()
    ahead = points[is_ahead(points)]
    assert np.array_equal(ring_by_ring(ahead), ahead)
    noisy = ahead + np.random.default_rng(0).normal(0, 0.1, ahead.shape).astype(np.float32)
    assert np.array_equal(ring_by_ring(noisy), noisy)


@given(count=st.integers(0, 300), seed=st.integers(0, 100), place=st.sampled_from([0.0, 5.0, 1e4]))
def test_the_points_stay_the_same(count, seed, place):
    drawn = np.random.default_rng(seed).normal(place, 3, (count, 4)).astype(np.float32)
    found = ring_by_ring(drawn)
    assert sorted(map(tuple, found)) == sorted(map(tuple, drawn))


def test_rings_begin_where_the_azimuth_falls_back():
    azimuth = np.array([0, 10, 36, -36, -20, 1, 30, -30], np.float32)
    assert number_rings(azimuth).tolist() == [0, 0, 0, 1, 1, 1, 1, 2]
    assert number_rings(azimuth[:0]).tolist() == []


FOCAL_PX, SIZE = 700.0, (300, 1000)
WALLS_DEG = np.sort(np.random.default_rng(1).uniform(-40, 40, 12))  # borders of walls
WALLS_M = np.random.default_rng(3).permutation(np.linspace(40, 80, len(WALLS_DEG) + 1))


def street_of_walls(tilt):
    """A road between upright walls, each of its own grey, by a camera at the LiDAR's place."""
    row, column = np.indices(SIZE)
    azimuth = np.degrees(np.arctan((SIZE[1] / 2 - column) / FOCAL_PX))
    wall = np.searchsorted(WALLS_DEG, azimuth)
    grey = np.random.default_rng(0).permutation(np.linspace(40, 250, len(WALLS_M)))[wall]
    flat = WALLS_M[wall] / np.hypot(1, (column - SIZE[1] / 2) / FOCAL_PX)
    grey = np.where(row - SIZE[0] / 2 > 1.8 * FOCAL_PX / flat, 20, grey).astype(np.uint8)
    elevation, turn = (
        np.radians(each.T.ravel())
        for each in np.meshgrid(np.linspace(20, -20, 64), np.arange(-180, 180, 0.2), indexing="ij")
    )
    flat = np.cos(elevation)
    own = np.stack((flat * np.cos(turn), flat * np.sin(turn), np.sin(elevation)), axis=1)
    rays = own @ tilt.level_from_lidar[:3, :3].T
    away = np.hypot(rays[:, 0], rays[:, 1])
    wall = np.searchsorted(WALLS_DEG, np.degrees(np.arctan2(rays[:, 1], rays[:, 0])))
    ranges = np.minimum(WALLS_M[wall] / away, 1.8 / np.maximum(-rays[:, 2], 1e-6))
    points = np.concatenate((own * ranges[:, None], np.full((len(own), 1), 0.3)), axis=1)
    middle = [[FOCAL_PX, 0, SIZE[1] / 2, 0], [0, FOCAL_PX, SIZE[0] / 2, 0], [0, 0, 1, 0]]
    level_from_lidar = torch.from_numpy(tilt.level_from_lidar)
    camera_from_level = torch.zeros(4, 4, dtype=torch.float64)
    camera_from_level[(0, 1, 2, 3), (1, 2, 0, 3)] = torch.tensor([-1.0, -1, 1, 1]).double()
    return CameraLidarSample(
        sample_id="walls",
        calibration=Calibration(
            image_from_camera=torch.tensor(middle).double(),
            camera_from_lidar=camera_from_level @ level_from_lidar,
        ),
        image_size=SIZE,
        image=torch.from_numpy(grey).expand(3, -1, -1).contiguous(),
        points=torch.from_numpy(points.astype(np.float32)),
        level_from_lidar=level_from_lidar,
    )


TILTS = [Tilt(roll_deg=0.0, pitch_deg=10.0), Tilt(roll_deg=1.0, pitch_deg=6.0)]


@pytest.mark.parametrize("turn_deg", [0.0, 1.5])
@pytest.mark.parametrize("tilt", TILTS, ids=str)
def test_the_yaw_of_a_tilted_lidar_is_the_same_in_any_order(tilt, turn_deg):
    by_shot = rotate_extrinsics(street_of_walls(tilt), turn_deg)
    points = by_shot.points.numpy()
    _, azimuth, elevation = to_sphere(points)
    by_ring = points[np.lexsort((azimuth, -np.rint(elevation / 40 * 63)))]
    found = []
    for each in (by_ring, points, ORDERS["shuffled"](points)):
        level = level_by_ring(replace(by_shot, points=torch.from_numpy(each)))
        assert level.level_from_lidar is None
        assert sorted(level.points[:, 0].tolist()) == sorted(
            level_sample(by_shot).points[:, 0].tolist()
        )
        found.append(estimate_yaw(match_edges(level)).yaw_deg)
    assert found == pytest.approx([turn_deg] * 3, abs=0.15)
    assert found[1:] == pytest.approx([found[0]] * 2, abs=0.02)


def test_a_tilted_sweep_ring_by_ring_or_without_rings_keeps_its_order():
    sample = street_of_walls(TILTS[0])
    rng = np.random.default_rng(0)
    chaos = torch.from_numpy(rng.normal(0, 20, (2000, 4)).astype(np.float32))
    _, azimuth, elevation = to_sphere(sample.points.numpy())
    by_ring = sample.points[np.lexsort((azimuth, -np.rint(elevation / 40 * 63)))]
    for points in (by_ring, chaos, chaos[:50]):
        changed = replace(sample, points=points)
        assert level_by_ring(changed).points.equal(level_sample(changed).points)
    level = replace(sample, level_from_lidar=None)
    assert level_by_ring(level) is level


def test_points_in_a_vehicles_frame_are_judged_as_seen_from_the_lidar():
    sample, monitor = replace(sound(), objects=None), HealthMonitor()
    raised = torch.eye(4, dtype=torch.float64)
    raised[2, 3] = -1.73
    on_road = replace(
        sample,
        points=sample.points + torch.tensor([0, 0, 1.73, 0]),
        calibration=Calibration(
            image_from_camera=sample.calibration.image_from_camera,
            camera_from_lidar=sample.calibration.camera_from_lidar @ raised,
        ),
        lidar_height_m=0.0,
    )
    expected, found = monitor(sample), monitor(on_road)
    assert found.lidar.score == pytest.approx(expected.lidar.score, abs=0.02)
    assert found.yaw_deg == pytest.approx(expected.yaw_deg, abs=0.02)

"""What else a rig does to its data: exposure row by row, dirt, order of points, its own car."""

from dataclasses import replace

import numpy as np
import pytest

from sightline.simulation.bodies.own_car import own_car
from sightline.simulation.camera.samples import RollingView, camera_view
from sightline.simulation.camera.windscreen import Dirt, draw_dirt, seen_through
from sightline.simulation.lidar import take_sweep
from sightline.simulation.rays.raycast import Raycaster
from sightline.simulation.rig_sensors import lidar_config, mount
from sightline.simulation.scene import Pose, world_from_footprint
from sightline.simulation.settings import SimulationConfig
from sightline.simulation.simulator import simulate_frame
from tests.simulation.small_streets import Straight, box_actor, courtyard, street
from tests.simulation.test_rig_frames import CAMERA, LIDAR, RIG, ROSETTE, frame_of

ROLLING = replace(RIG, camera=replace(CAMERA, readout_ms=40.0))
SPEED_MPS = 14.0


def driven(rng: np.random.Generator, *, duration_s: float):  # noqa: ARG001
    ego = Straight(Pose(x=0.0, y=0.0, z=0.0, yaw=0.1), SPEED_MPS)
    return street(box_actor(12.0, 3.0, class_name="Misc"), scenery=courtyard(), ego=ego)


def view_at(time_s):
    pose = Straight(Pose(x=0.0, y=0.0, z=0.0, yaw=0.1), SPEED_MPS).at(time_s)
    return camera_view(mount(RIG).level_calibration, pose, LIDAR.height_m)


def test_each_row_is_seen_from_where_the_car_is_at_its_time():
    view = RollingView(first=view_at(-0.02), last=view_at(0.02), num_rows=240)
    rows = np.array([0, 60, 119.5, 239], np.float32)
    columns = np.array([3, 200, 90, 399], np.float32)
    rays = view.rays(columns, rows)
    for ray, (column, row) in enumerate(zip(columns, rows, strict=True)):
        one = view_at(-0.02 + 0.04 * float(row) / 239).rays(column[None], row[None])
        np.testing.assert_allclose(rays.origins[ray], one.origins[0], atol=1e-5)
        np.testing.assert_allclose(rays.directions[ray], one.directions[0], atol=1e-5)


def test_a_rolling_exposure_sees_the_bottom_later_and_the_middle_at_the_frames_time():
    still, rolling = (
        simulate_frame(SimulationConfig(rig=rig), 0, driven).depth_m for rig in (RIG, ROLLING)
    )
    nearer_m = still - rolling
    # The wall ahead, above the horizon, and the middle of the image.
    since_s = (64 / 239 - 0.5) * 0.04
    assert np.median(nearer_m[63:66, 190:210]) == pytest.approx(since_s * SPEED_MPS, abs=0.02)
    assert np.abs(np.median(nearer_m[119:121, 190:210])) < 0.01


def test_a_rolling_exposure_leaves_labels_and_points():
    still, rolling = (
        simulate_frame(SimulationConfig(rig=rig), 0, driven) for rig in (RIG, ROLLING)
    )
    np.testing.assert_array_equal(still.points, rolling.points)
    np.testing.assert_array_equal(still.objects.boxes2d, rolling.objects.boxes2d)
    np.testing.assert_array_equal(still.objects.occlusion, rolling.objects.occlusion)


def test_a_car_that_stands_has_the_same_picture_with_a_rolling_exposure():
    np.testing.assert_allclose(frame_of(ROLLING).depth_m, frame_of(RIG).depth_m, atol=1e-3)


def test_dirt_changes_the_picture_alone_and_stays_through_a_drive():
    plain, dirty = (
        frame_of(replace(RIG, camera=replace(CAMERA, dirt=amount))) for amount in (0.0, 0.8)
    )
    np.testing.assert_array_equal(plain.depth_m, dirty.depth_m)
    np.testing.assert_array_equal(plain.points, dirty.points)
    assert plain.image is not None
    assert dirty.image is not None
    assert np.abs(plain.image.astype(int) - dirty.image).mean() > 2


def test_more_dirt_keeps_back_more_light():
    covers = [
        draw_dirt(np.random.default_rng(3), (300, 400), amount).cover for amount in (0.0, 0.3, 1.0)
    ]
    assert all(cover.shape == (300, 400) for cover in covers)
    assert not covers[0].any()
    assert 0 < covers[1].mean() < covers[2].mean() < 0.6
    assert covers[2].max() <= 1


def test_light_behind_dirt_is_a_mean_of_the_scene_and_the_dirts_glow():
    radiance = np.zeros((2, 2, 3), np.float32)
    radiance[0, 0] = (4.0, 2.0, 0.0)
    seen = seen_through(Dirt(np.array([[0, 0.5], [1, 0]], np.float32)), radiance)
    glow = 0.55 * np.array([1.0, 0.5, 0.0])
    np.testing.assert_allclose(seen[0, 0], (4, 2, 0))
    np.testing.assert_allclose(seen[0, 1], 0.5 * glow, rtol=1e-6)
    np.testing.assert_allclose(seen[1, 0], glow, rtol=1e-6)


def swept(rig, **options):
    scene = street(box_actor(9.0, 2.0), scenery=courtyard()).snapshot()
    return take_sweep(
        scene,
        Raycaster(scene.mesh),
        rng=np.random.default_rng(0),
        config=lidar_config(rig),
        **options,
    )


def as_rows(points):
    return sorted(map(tuple, points.tolist()))


@pytest.mark.parametrize("lidar", [LIDAR, ROSETTE], ids=["rings", "rosette"])
@pytest.mark.parametrize("order", ["firings", "none"])
def test_another_order_has_the_same_points(lidar, order):
    assert as_rows(swept(replace(lidar, order=order))) == as_rows(swept(lidar))


def test_points_in_the_order_of_the_firings_turn_from_behind_and_jump_between_rings():
    points = swept(replace(LIDAR, order="firings")).astype(np.float64)
    azimuths = np.degrees(np.arctan2(points[:, 1], points[:, 0]))
    assert (np.diff(azimuths) > -0.2).all()  # millimetres blur the angles of near points
    assert azimuths[0] < -179
    assert azimuths[-1] > 179
    elevations = np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1]))
    falls = np.diff(elevations) < 0
    assert 0.3 < falls.mean() < 0.7


def test_points_without_order_tell_neither_ring_nor_azimuth():
    points = swept(replace(LIDAR, order="none")).astype(np.float64)
    ranks = np.arange(len(points))
    for angle in (np.arctan2(points[:, 1], points[:, 0]), points[:, 2]):
        assert abs(np.corrcoef(ranks, angle)[0, 1]) < 0.05


def test_the_own_car_returns_points_on_its_body_and_hides_what_is_below():
    lidar = replace(LIDAR, roof_m=1.5, range_noise_m=0.0)
    car = own_car(np.random.default_rng(1), 1.5)
    points = swept(lidar, own_car=car)[:, :3].astype(np.float64)
    plain = swept(replace(lidar, roof_m=0.0))
    low, high = car.vertices.min(axis=0), car.vertices.max(axis=0)
    assert high[2] == pytest.approx(1.5, abs=1e-5)
    above = points + np.array([0.0, 0.0, lidar.height_m])
    own = ((above > low - 0.01) & (above < high + 0.01)).all(axis=1)
    assert own.sum() > 200
    assert len(points) - own.sum() < len(plain)
    # No return from the road below the car, nor anything inside of it.
    assert above[own, 2].max() == pytest.approx(high[2], abs=0.05)
    assert above[own, 2].min() > 0.2
    assert np.linalg.norm(points[own], axis=1).min() >= 0.4


def test_the_own_car_is_no_object_and_the_camera_does_not_see_it():
    plain, carried = (
        frame_of(replace(RIG, lidar=replace(LIDAR, roof_m=roof_m))) for roof_m in (0.0, 1.6)
    )
    np.testing.assert_array_equal(plain.image, carried.image)
    assert carried.objects.class_names == plain.objects.class_names
    near = np.linalg.norm(carried.points[:, :2], axis=1) < 2.0
    assert near.sum() > 100
    pose = world_from_footprint(Pose(x=0.0, y=0.0, z=0.0, yaw=0.0), LIDAR.height_m)
    heights = carried.points[near, :3] @ pose[2, :3] + pose[2, 3]
    assert np.median(heights) > 0.7

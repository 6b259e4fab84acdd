from dataclasses import replace

import numpy as np
import pytest
import torch

import sightline
from sightline.data.check import check_tree
from sightline.geometry.transforms import transform_points
from sightline.simulation.dataset import sample_of
from sightline.simulation.lidar import take_sweep
from sightline.simulation.lidar_config import LIDARS
from sightline.simulation.rays.raycast import Raycaster
from sightline.simulation.rig_sensors import lidar_config, mount
from sightline.simulation.rigs import CameraRig, LidarRig, Rig, Rosette, named_rig
from sightline.simulation.settings import PRESETS, SimulationConfig
from sightline.simulation.simulator import rig_of, sensors_of, simulate_frame
from tests.simulation.data_sets import content, make
from tests.simulation.small_streets import box_actor, courtyard, make_tiny_street, street

RINGS = tuple(np.linspace(15, -25, 48).round(2).tolist())
CAMERA = CameraRig(image_size=(240, 400), focal_px=260.0, height_m=1.5, ahead_m=0.4, left_m=0.2)
LIDAR = LidarRig(elevations_deg=RINGS, azimuth_step_deg=0.4, height_m=1.9)
RIG = Rig(name="mine", camera=CAMERA, lidar=LIDAR)
DOWN = replace(CAMERA, pitch_deg=8.0, roll_deg=3.0)
UP = replace(CAMERA, pitch_deg=-8.0, roll_deg=-3.0, principal_px=(180.0, 110.0))
TILTED = replace(LIDAR, pitch_deg=3.0, roll_deg=-2.0)
ROSETTE = LidarRig(rosette=Rosette(width_deg=80.0, height_deg=30.0, points=12_000), height_m=1.6)
RIGS = {
    "level": RIG,
    "down": replace(RIG, camera=DOWN),
    "up": replace(RIG, camera=UP),
    "tilted LiDAR": replace(RIG, lidar=TILTED),
    "both": replace(RIG, camera=DOWN, lidar=TILTED),
    "rosette": replace(RIG, camera=UP, lidar=ROSETTE),
}


def cars(rng: np.random.Generator, *, duration_s: float):  # noqa: ARG001
    places = ((9.0, 2.5, 0.3), (14.0, -3.0, -1.2), (22.0, 0.5, 0.8))
    actors = [box_actor(x, y, yaw=yaw, class_name="Misc") for x, y, yaw in places]
    return street(*actors, scenery=courtyard())


def frame_of(rig: Rig, **settings):
    return simulate_frame(SimulationConfig(rig=rig, **settings), 0, cars)


def in_boxes(sample):
    """The row of the labelled box of each point; -1: none."""
    rows = torch.full((len(sample.points),), -1)
    level = sample.level_from_lidar
    rotation = torch.eye(4, dtype=torch.float64) if level is None else level
    points = transform_points(rotation, sample.points[:, :3].double())
    boxes = sample.objects.boxes3d.to_level(rotation).tensor
    for row in sample.objects.has_box3d.nonzero()[:, 0].tolist():
        x, y, z, *size, yaw = boxes[row].tolist()
        away = points - torch.tensor([x, y, z], dtype=torch.float64)
        cos, sin = np.cos(yaw), np.sin(yaw)
        along, across = cos * away[:, 0] + sin * away[:, 1], cos * away[:, 1] - sin * away[:, 0]
        own = torch.stack((along, across, away[:, 2]), dim=1).abs()
        inside = (own < torch.tensor(size, dtype=torch.float64) / 2 + 0.05).all(dim=1)
        inside &= points[:, 2] > points.new_tensor(z - size[2] / 2 + 0.1)  # not the road
        rows[inside] = row
    return rows


@pytest.mark.parametrize("rig", RIGS.values(), ids=RIGS)
def test_points_in_a_labelled_box_fall_on_its_pixels(rig):
    frame = frame_of(rig)
    sample = sample_of(frame)
    rows = in_boxes(sample)
    homogeneous = transform_points(
        sample.calibration.image_from_lidar, sample.points[:, :3].double()
    )
    depth = homogeneous[:, 2]
    x, y = (homogeneous[:, :2] / depth[:, None]).round().long().T
    height, width = sample.image_size
    seen = (rows >= 0) & (depth > 0) & (x >= 0) & (x < width) & (y >= 0) & (y < height)
    assert int(seen.sum()) > 100
    shown = torch.from_numpy(frame.instances)[y[seen], x[seen]] - 1
    # The rest lies beside an edge, or is hidden from the camera but not from the LiDAR.
    assert float((shown == rows[seen]).double().mean()) > 0.9
    on = shown == rows[seen]
    error_m = (sample.depth[y[seen], x[seen]] - depth[seen])[on].abs()
    assert float(error_m.median()) < 0.1


@pytest.mark.parametrize("rig", RIGS.values(), ids=RIGS)
def test_labelled_boxes_have_the_true_middles_and_headings_at_any_pitch(rig):
    sample = sample_of(frame_of(rig))
    level = sample.level_from_lidar
    rotation = torch.eye(4, dtype=torch.float64) if level is None else level
    boxes = sample.objects.boxes3d.to_level(rotation).tensor[:3]
    expected = [(9.0, 2.5, 0.3), (14.0, -3.0, -1.2), (22.0, 0.5, 0.8)]
    for box, (x, y, yaw) in zip(boxes.tolist(), expected, strict=True):
        assert box[:3] == pytest.approx([x, y, 0.75 - rig.lidar.height_m], abs=1e-6)
        assert np.sin(box[6] - yaw) == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("rig", [RIGS["level"], RIGS["down"], RIGS["up"]])
def test_2d_boxes_bound_the_visible_pixels_at_any_pitch(rig):
    frame = frame_of(rig)
    near = frame.objects.boxes2d[0], frame.visible_boxes[0]  # nothing hides it
    assert np.abs(near[0] - near[1]).max() <= 1.5


def test_the_horizon_is_where_pitch_and_focal_length_put_it():
    for pitch_deg in (-5.0, 0.0, 5.0):
        rig = replace(RIG, camera=replace(CAMERA, pitch_deg=pitch_deg))
        calibration = mount(rig).level_calibration
        far = calibration.camera_from_lidar[:3, :3] @ np.array([1.0, 0.0, 0.0])
        x, y, z = calibration.image_from_camera[:, :3] @ far
        assert x / z == pytest.approx(199.5)
        assert y / z == pytest.approx(119.5 - 260 * np.tan(np.radians(pitch_deg)))


def test_a_roll_to_the_right_turns_the_picture_to_the_left():
    rig = replace(RIG, camera=replace(CAMERA, roll_deg=3.0))
    up = mount(rig).level_calibration.camera_from_lidar[:3, :3] @ np.array([0.0, 0.0, 1.0])
    assert up[0] == pytest.approx(-np.sin(np.radians(3.0)))


def test_points_of_a_tilted_lidar_are_in_its_own_frame():
    frame = frame_of(RIGS["tilted LiDAR"])
    elevations = np.degrees(np.arctan2(frame.points[:, 2], np.hypot(*frame.points[:, :2].T)))
    nearest = np.abs(elevations[:, None] - np.array(RINGS)).min(axis=1)
    assert np.quantile(nearest, 0.99) < 0.1
    assert frame.lidar_pose is not None
    assert frame.lidar_pose.tilt is not None
    level = frame.points[:, :3] @ frame.lidar_pose.tilt.level_from_lidar[:3, :3].T
    road = level[(np.abs(level[:, 2] + 1.9) < 0.1), 2]
    assert len(road) > 500
    assert np.median(road) == pytest.approx(-1.9, abs=0.02)


def test_a_rosette_fills_its_field_and_nothing_else():
    points = frame_of(RIGS["rosette"]).points
    azimuths = np.degrees(np.arctan2(points[:, 1], points[:, 0]))
    assert 30 < azimuths.max() <= 40.1
    assert -40.1 <= azimuths.min() < -30


def test_noise_range_and_reflectance_are_those_of_the_rig():
    scene = street(scenery=courtyard(30.0)).snapshot()
    raycaster = Raycaster(scene.mesh)

    def sweep(**changes):
        config = lidar_config(replace(LIDAR, **changes))
        return take_sweep(scene, raycaster, rng=np.random.default_rng(0), config=config)

    exact, noisy = sweep(range_noise_m=0.0), sweep(range_noise_m=0.05)
    ranges = (np.linalg.norm(each[:, :3], axis=1) for each in (exact, noisy))
    assert np.std(np.subtract(*ranges)) == pytest.approx(0.05, rel=0.1)
    assert sweep(reflectance=0.0)[:, 3].max() == 0
    assert 0 < sweep(reflectance=0.5)[:, 3].mean() < 0.6 * exact[:, 3].mean()
    assert np.linalg.norm(sweep(range_m=20.0)[:, :3], axis=1).max() <= 20.1


def test_a_bonnet_hides_the_road_below_and_belongs_to_no_object():
    plain, covered = (
        frame_of(replace(RIG, camera=replace(DOWN, roll_deg=0.0, bonnet_m=bonnet_m)))
        for bonnet_m in (0.0, 1.1)
    )
    near = covered.depth_m < 2
    assert 0.02 < near.mean() < 0.5
    assert near[-1].mean() > 0.5
    assert not covered.instances[near].any()
    np.testing.assert_array_equal(covered.depth_m[~near], plain.depth_m[~near])


def test_white_balance_and_jpeg_change_the_picture_alone():
    plain = frame_of(RIG)
    warm = frame_of(replace(RIG, camera=replace(CAMERA, white_balance=(1.2, 1.0, 0.8))))
    packed = frame_of(replace(RIG, camera=replace(CAMERA, jpeg_quality=50)))
    assert plain.image is not None
    assert warm.image is not None
    assert packed.image is not None
    grey = (plain.image < 150).all(axis=-1)
    red, green, blue = (warm.image[grey] / np.maximum(plain.image[grey], 1)).mean(axis=0)
    assert red > 1.1
    assert green == 1
    assert blue < 0.9
    difference = np.abs(packed.image.astype(int) - plain.image)
    assert 0 < difference.mean() < 8
    for other in (warm, packed):
        np.testing.assert_array_equal(other.depth_m, plain.depth_m)
        np.testing.assert_array_equal(other.points, plain.points)


def test_a_measured_model_keeps_its_lasers_in_a_rig():
    lidar = mount(named_rig("nuscenes")).lidar
    assert lidar.lasers == LIDARS["hdl-32e"].lasers
    assert lidar.height_m == 1.84


def test_each_frame_has_another_random_rig_and_the_same_again():
    config = PRESETS["street-rigs-8k"].config
    rigs = [rig_of(config, drive) for drive in range(20)]
    assert len({each.camera for each in rigs}) == 20
    assert rigs == [rig_of(config, drive) for drive in range(20)]
    assert rig_of(replace(config, seed=1), 0) != rigs[0]


def test_named_rigs_have_fifty_frames_each():
    preset = PRESETS["rigs-val-600"]
    rigs = [rig_of(preset.config, drive) for drive in range(preset.frames)]
    assert preset.frames == 600
    assert all(rigs.count(rig) == 50 for rig in set(rigs))
    assert len(set(rigs)) == 12


def test_without_a_rig_sensors_are_kittis():
    sensors = sensors_of(SimulationConfig(), 0)
    assert sensors.lidar_pose is None
    assert sensors.image_size == (375, 1242)
    assert sensors.lidar.lasers == LIDARS["hdl-64e"].lasers


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"rig": RIG, "lidar": "vlp-16"}, "a rig has its own lidar; leave out lidar or the rig"),
        ({"rig": "random", "focal_px": 500.0}, "a rig has its own focal_px"),
        ({"rig": RIG, "image_size": (400, 400)}, "a rig has its own image_size"),
        ({"rig": "random", "sequence_length": 3}, "a drive has one rig for all frames"),
    ],
)
def test_settings_against_the_rig_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        SimulationConfig(**settings)


def test_files_of_rigs_are_read_with_each_frames_height_and_tilt(tmp_path):
    other = replace(RIGS["both"], lidar=replace(TILTED, height_m=2.4))
    for name, rig in (("a", RIG), ("b", other)):
        make(tmp_path / name, 1, SimulationConfig(rig=rig), workers=1)
    for part in ("image_2", "velodyne", "calib", "label_2", "depth"):
        source = next((tmp_path / "b" / "training" / part).iterdir())
        target = tmp_path / "a" / "training" / part / f"000001{source.suffix}"
        target.write_bytes(source.read_bytes())
    first, second = sightline.open_dataset(tmp_path / "a")
    assert first.lidar_height_m == pytest.approx(1.9)
    assert first.level_from_lidar is None
    assert second.lidar_height_m == pytest.approx(2.4)
    tilt = mount(other).lidar.tilt
    assert tilt is not None
    np.testing.assert_allclose(second.level_from_lidar, tilt.level_from_lidar, atol=1e-12)
    simulated = sample_of(simulate_frame(SimulationConfig(rig=other), 0, make_tiny_street))
    np.testing.assert_allclose(
        second.objects.boxes3d.tensor, simulated.objects.boxes3d.tensor, atol=0.02
    )
    assert list(check_tree(tmp_path / "a", num_workers=1)) == []


def test_a_drive_of_a_rig_has_its_calibration_and_poses(tmp_path):
    config = SimulationConfig(sequence_length=2, rig=RIGS["both"])
    make(tmp_path, 2, config, workers=1)
    poses = np.loadtxt(next(tmp_path.rglob("poses.txt"))).reshape(-1, 3, 4)
    frame = simulate_frame(config, 1, make_tiny_street)
    np.testing.assert_allclose(poses[1], frame.world_from_lidar[:3])


def test_the_manifest_has_a_rig_only_where_one_is_set(tmp_path):
    make(tmp_path / "kitti", 1, workers=1)
    make(tmp_path / "rig", 1, SimulationConfig(rig=RIG), workers=1)
    assert b'"rig"' not in content(tmp_path / "kitti")["simulation.json"]
    assert b'"focal_px": 260.0' in content(tmp_path / "rig")["simulation.json"]
    with pytest.raises(ValueError, match="rig"):
        make(tmp_path / "rig", 1, SimulationConfig(rig=RIGS["down"]), workers=1)

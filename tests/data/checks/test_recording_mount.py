"""How the LiDAR of a recording is mounted: turned, tilted, at which height, by file and by road."""

import math
import shutil
import warnings

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from sightline.data.check import check_tree, summarize_tree
from sightline.data.open import open_dataset
from sightline.geometry.mount_axes import axes_doubt
from sightline.geometry.road_height import lidar_pose
from sightline.geometry.tilt import Tilt
from sightline.structures.level import level_sample
from tests.data.recordings import (
    CAMERA_FROM_LIDAR,
    LABELS,
    POINTS,
    SAMPLE,
    write_calibration,
    write_cloud_file,
    write_recording,
)

TURNED = {
    "is probably inverted": np.linalg.inv(CAMERA_FROM_LIDAR),
    "has the identity for its rotation": np.eye(4),
    "has its axes swapped": np.diag([1.0, -1, -1, 1]) @ CAMERA_FROM_LIDAR,
    "probably in degrees where radians": None,
    "probably in millimetres": CAMERA_FROM_LIDAR * np.array([[1, 1, 1, 1000]] * 3 + [[1] * 4]),
}


@pytest.mark.parametrize("cause", TURNED)
def test_each_mistake_in_a_mount_is_named_by_opening_and_by_check(tmp_path, cause):
    wrong = TURNED[cause]
    if wrong is None:  # R = Rz(90 rad) .. instead of degrees
        wrong = CAMERA_FROM_LIDAR.copy()
        angles_deg = Rotation.from_matrix(wrong[:3, :3]).as_euler("XYZ", degrees=True)
        wrong[:3, :3] = Rotation.from_euler("XYZ", angles_deg).as_matrix()
    write_recording(tmp_path, ("a",), camera_from_lidar=wrong.tolist())
    with pytest.warns(UserWarning, match=cause):
        open_dataset(tmp_path)
    (problem,) = check_tree(tmp_path)
    assert cause in problem.problem
    assert problem.path == tmp_path / "calibration.yaml"


def boxes_of_cars(sample):
    return sample.objects.boxes3d.tensor[sample.objects.has_box3d]


@pytest.mark.parametrize("yaw_deg", [8, -50, 90, 179])
def test_a_lidar_that_is_mounted_turned_keeps_its_frame_and_its_level_one_looks_ahead(
    tmp_path, yaw_deg
):
    old_from_new = np.eye(4)
    old_from_new[:3, :3] = Rotation.from_euler("z", yaw_deg, degrees=True).as_matrix()
    mounted = CAMERA_FROM_LIDAR @ old_from_new.T
    write_recording(tmp_path, ("a",), cloud=".npy", camera_from_lidar=mounted.tolist())
    places = POINTS[:, :3].astype(np.float64) @ old_from_new[:3, :3].T
    write_cloud_file(
        tmp_path / "points" / "a.npy", np.column_stack((places, POINTS[:, 3])).astype(np.float32)
    )
    (tmp_path / "labels").mkdir()
    shutil.copy(LABELS, tmp_path / "labels" / "a.txt")
    mounted_sample = open_dataset(tmp_path)[0]
    torch.testing.assert_close(
        mounted_sample.points[:, :3].double(), torch.from_numpy(places), rtol=0, atol=2e-5
    )
    sample = level_sample(mounted_sample)
    torch.testing.assert_close(sample.points, SAMPLE.points, rtol=0, atol=2e-5)
    ours, true = sample.calibration.image_from_lidar, SAMPLE.calibration.image_from_lidar
    torch.testing.assert_close(ours, true, rtol=0, atol=1e-9)
    boxes, expected = sample.objects.boxes3d.tensor, SAMPLE.objects.boxes3d.tensor
    # KITTI's files are of camera 0, whose centre is not the recording's.
    torch.testing.assert_close(boxes[:, 3:], expected[:, 3:], rtol=0, atol=1e-9)
    turned = boxes_of_cars(mounted_sample)[:, 6] - boxes_of_cars(sample)[:, 6]
    turned = torch.rad2deg(turned) - yaw_deg
    torch.testing.assert_close((turned + 180) % 360, torch.full_like(turned, 180))
    assert list(check_tree(tmp_path)) == []
    (summary,) = summarize_tree(tmp_path)
    assert f"the camera looks {yaw_deg} degrees (counter-clockwise)" in str(summary)


def test_points_that_the_image_does_not_show_are_told_with_their_share(tmp_path):
    write_recording(tmp_path, ("a",), cloud=".npy")
    write_cloud_file(tmp_path / "points" / "a.npy", POINTS * np.float32([-1, -1, 1, 1]))
    with pytest.warns(UserWarning, match=r"projects only \d+ of the \d+ points of frame a into"):
        open_dataset(tmp_path)
    assert len(list(check_tree(tmp_path))) == 1


def test_the_height_of_the_lidar_is_that_of_the_file_or_told_by_some_clouds(tmp_path):
    write_recording(tmp_path, ("a", "b", "c"), cloud=".npy")
    write_cloud_file(tmp_path / "points" / "b.npy", POINTS[:25])  # shows no road
    assert open_dataset(tmp_path, sample_list=("b",))[0].lidar_height_m == pytest.approx(
        1.73, abs=0.1
    )
    write_calibration(tmp_path, lidar_height_m=2.31)
    with pytest.warns(UserWarning, match=r"lidar_height_m is 2.31, but the road .* gives 1.7"):
        assert open_dataset(tmp_path)[0].lidar_height_m == 2.31
    (summary,) = summarize_tree(tmp_path)
    assert "above it" not in str(summary)
    (problem,) = check_tree(tmp_path)
    assert "calibration.yaml: lidar_height_m is 2.31, but the road in the" in str(problem)
    write_calibration(tmp_path)
    for place, name in enumerate("abc"):
        write_cloud_file(tmp_path / "points" / f"{name}.npy", POINTS[: 25 + place])
    with pytest.warns(UserWarning, match=r"too little of the road .*: KITTI's 1.73 m is"):
        assert open_dataset(tmp_path)[0].lidar_height_m is None
    (summary,) = summarize_tree(tmp_path)
    assert "warning: its clouds show too little of the road" in str(summary)
    assert "KITTI's 1.73 m is assumed" in str(summary)


def test_a_tilt_that_no_road_shows_beside_a_given_height_is_told(tmp_path):
    write_recording(tmp_path, ("a",), cloud=".npy", lidar_height_m=6.0)
    random = np.random.default_rng(0)
    cloud = random.uniform((5, -15, 1, 0), (35, 15, 6, 1), (4000, 4)).astype(np.float32)
    write_cloud_file(tmp_path / "points" / "a.npy", cloud)
    told = "find the LiDAR's tilt beside its given height: a level one is assumed; give lidar_tilt"
    with pytest.warns(UserWarning, match=told):
        open_dataset(tmp_path)
    (summary,) = summarize_tree(tmp_path)
    assert f"warning: too little of the road is visible to {told}" in str(summary)
    write_calibration(tmp_path, lidar_height_m=6.0, lidar_tilt_deg={"roll": 0, "pitch": 0})
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        open_dataset(tmp_path)
    assert not any("tilt" in str(each.message) for each in caught)


def test_the_height_is_not_spoken_of_where_no_cloud_can_be_read(tmp_path):
    write_recording(tmp_path, ("a",), cloud=".npy")
    for content in (b"nothing", None):
        path = tmp_path / "points" / "a.npy"
        path.write_bytes(content) if content else np.save(path, np.full((50, 4), np.nan))
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            open_dataset(tmp_path)
        assert not any("road" in str(each.message) for each in caught)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            (summary,) = summarize_tree(tmp_path)
        assert "road" not in str(summary)
        cause = "1 of 1 checked clouds cannot be read" if content else "checked clouds are empty"
        assert cause in str(summary)


def test_the_height_by_the_road_is_told_beside_a_given_one(tmp_path):
    write_recording(tmp_path, ("a", "b", "c"), cloud=".npy")
    write_calibration(tmp_path, lidar_height_m=2.0)
    (summary,) = summarize_tree(tmp_path)
    assert "lidar_height_m is 2; by the road in its clouds the LiDAR is 1.7" in str(summary)


def write_tilted_recording(folder, tilt, **changes):
    lidar_from_level = tilt.level_from_lidar.T
    mounted = CAMERA_FROM_LIDAR @ tilt.level_from_lidar
    write_recording(folder, ("a", "b", "c"), camera_from_lidar=mounted.tolist(), **changes)
    places = POINTS[:, :3].astype(np.float64) @ lidar_from_level[:3, :3].T
    cloud = np.column_stack((places, POINTS[:, 3])).astype(np.float32)
    for place, name in enumerate("abc"):
        write_cloud_file(folder / "points" / f"{name}.pcd", cloud[: len(cloud) - place])
    (folder / "labels").mkdir()
    for name in "abc":
        shutil.copy(LABELS, folder / "labels" / f"{name}.txt")


@pytest.mark.parametrize(("roll_deg", "pitch_deg"), [(3.0, 12.0), (0.0, -8.0), (-10.0, 0.0)])
def test_a_tilted_lidar_is_found_by_the_road_said_and_levelled(tmp_path, roll_deg, pitch_deg):
    tilt = Tilt(roll_deg=roll_deg, pitch_deg=pitch_deg)
    write_tilted_recording(tmp_path, tilt)
    with pytest.warns(UserWarning, match="the road in its clouds shows that the LiDAR is tilted, "):
        dataset = open_dataset(tmp_path)
    found = dataset[0].level_from_lidar.numpy()
    assert found[2, :3] @ tilt.up > math.cos(math.radians(1.0))
    assert dataset[0].lidar_height_m == pytest.approx(1.73, abs=0.1)
    (summary,) = summarize_tree(tmp_path)
    assert "by the road in its clouds the LiDAR is tilted, " in str(summary)
    assert list(check_tree(tmp_path)) == []


def test_a_tilt_that_the_calibration_gives_is_taken_and_labels_match_in_the_level_frame(tmp_path):
    tilt = Tilt(roll_deg=3.0, pitch_deg=12.0)
    write_tilted_recording(tmp_path, tilt, lidar_tilt_deg={"roll": 3.0, "pitch": 12.0})
    sample = open_dataset(tmp_path)[0]
    assert sample.lidar_height_m == pytest.approx(1.73, abs=0.1)
    level = level_sample(sample)
    torch.testing.assert_close(level.points, SAMPLE.points, rtol=0, atol=2e-3)
    (tmp_path / "level").mkdir()
    write_recording(tmp_path / "level", ("a",))
    (tmp_path / "level" / "labels").mkdir()
    shutil.copy(LABELS, tmp_path / "level" / "labels" / "a.txt")
    expected = open_dataset(tmp_path / "level")[0].objects.boxes3d.tensor
    torch.testing.assert_close(level.objects.boxes3d.tensor, expected, rtol=0, atol=1e-9)
    assert (boxes_of_cars(sample)[:, 2] - boxes_of_cars(level)[:, 2]).abs().max() > 1


@pytest.mark.parametrize(("roll_deg", "pitch_deg"), [(0.0, 30.0), (40.0, 0.0)])
def test_a_steep_tilt_that_the_calibration_gives_is_no_fault_of_the_transform(
    tmp_path, recwarn, roll_deg, pitch_deg
):
    tilt = Tilt(roll_deg=roll_deg, pitch_deg=pitch_deg)
    given = {"roll": roll_deg, "pitch": pitch_deg}
    write_tilted_recording(tmp_path, tilt, lidar_tilt_deg=given)
    assert list(check_tree(tmp_path)) == []
    open_dataset(tmp_path)
    assert not recwarn.list


def test_a_tilt_that_the_road_contradicts_is_told(tmp_path):
    write_recording(tmp_path, ("a",), lidar_tilt_deg={"roll": 0, "pitch": 12})
    (summary,) = summarize_tree(tmp_path)
    assert "by its calibration the LiDAR is tilted, 12.0 degrees nose down" in str(summary)
    (problem,) = check_tree(tmp_path)
    assert "calibration.yaml: lidar_tilt_deg is 12.0 degrees nose down" in str(problem)
    assert str(problem).endswith("the sweeps gives none; correct it (degrees), or omit it")
    with pytest.warns(UserWarning, match="but the road in the sweeps gives none"):
        open_dataset(tmp_path)


def test_clouds_with_z_down_are_told_to_be_converted_with_their_calibration(tmp_path):
    turn = np.diag([1.0, -1, -1, 1])
    down = POINTS * np.float32([1, -1, -1, 1])
    both, cloud_alone = tmp_path / "both", tmp_path / "cloud"
    write_recording(both, ("a",), camera_from_lidar=(CAMERA_FROM_LIDAR @ turn).tolist())
    write_recording(cloud_alone, ("a",))
    for folder, said in (
        (both, "convert both, points and"),
        (cloud_alone, "convert only the points"),
    ):
        write_cloud_file(folder / "points" / "a.pcd", down)
        with pytest.warns(UserWarning, match=said):
            open_dataset(folder)
        problems = [each for each in check_tree(folder) if said in each.remedy]
        assert problems, said
        assert "-z points up" in problems[0].problem
        assert problems[0].path == folder / "points" / "a.pcd"
        (summary,) = summarize_tree(folder)
        assert "too little of the road" not in str(summary)


def test_clouds_with_z_down_have_no_height_or_tilt_by_what_lies_below_in_them(tmp_path):
    turn = np.diag([1.0, -1, -1, 1])
    write_recording(tmp_path, ("a",), camera_from_lidar=(CAMERA_FROM_LIDAR @ turn).tolist())
    x, y = (each.ravel() for each in np.meshgrid(np.arange(-29.5, 30), np.arange(-29.5, 30)))
    random = np.random.default_rng(0)
    above = random.choice([0.7, np.nan], len(x), p=[0.2, 0.8])  # roofs of one height
    above = np.where(np.isnan(above), random.uniform(-1, 6, len(x)), above)
    road = np.full_like(x, -1.7)
    up = np.concatenate([np.stack((x, y, z, 0 * z), axis=-1) for z in (road, above)])
    down = (up @ turn).astype(np.float32)
    write_cloud_file(tmp_path / "points" / "a.pcd", down)
    assert axes_doubt(down, CAMERA_FROM_LIDAR @ turn) is not None
    assert lidar_pose([down]).height_m == pytest.approx(0.7, abs=0.1)
    (summary,) = summarize_tree(tmp_path)
    assert "above it" not in str(summary)


def test_a_tilt_of_zeros_is_as_none_and_keeps_the_clouds_from_being_levelled(tmp_path):
    write_recording(tmp_path / "level", ("a",), lidar_tilt_deg={"roll": 0, "pitch": 0.04})
    assert open_dataset(tmp_path / "level")[0].level_from_lidar is None
    (summary,) = summarize_tree(tmp_path / "level")
    assert "tilted" not in str(summary)
    assert list(check_tree(tmp_path / "level")) == []
    tilt = Tilt(roll_deg=0.0, pitch_deg=12.0)
    write_tilted_recording(tmp_path / "tilted", tilt, lidar_tilt_deg={"roll": 0, "pitch": 0})
    with pytest.warns(UserWarning, match="but the road in the sweeps gives 1"):
        dataset = open_dataset(tmp_path / "tilted")
    assert dataset[0].level_from_lidar is None

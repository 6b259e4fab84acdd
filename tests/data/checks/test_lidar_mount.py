import math
import warnings

import pytest
import torch

from sightline.data.check import check_tree, summarize_tree
from sightline.data.checks.lidar_mount import pose_of_tree, record_pose
from sightline.data.formats.kitti_files import (
    write_image,
    write_object_calibration,
    write_points,
    write_raw_calibration,
)
from sightline.data.layouts.kitti_trees import list_object_frames
from sightline.data.open import open_dataset
from sightline.geometry.calibration import Calibration
from sightline.geometry.tilt import Tilt
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.structures.level import level_sample
from tests.data.recordings import SAMPLE

LEVEL = torch.eye(4, dtype=torch.float64)
LABELS = PACKAGED_FRAMES / "training" / "label_2" / "000000.txt"
KINDS = pytest.mark.parametrize("kind", ["tree", "drive"])


def write_frames(root, kind, mounted_from_level, *, names=("000000", "000001", "000002")):
    """One frame of a LiDAR that is mounted so, again and again, in files that differ a little."""
    points = SAMPLE.points.clone()
    places = points[:, :3].double() @ mounted_from_level[:3, :3].T + mounted_from_level[:3, 3]
    points[:, :3] = places.float()
    mounted = Calibration(
        image_from_camera=SAMPLE.calibration.image_from_camera,
        camera_from_lidar=SAMPLE.calibration.camera_from_lidar @ mounted_from_level.inverse(),
    )
    folder = root / "training" if kind == "tree" else root
    images, sweeps = ("image_2", "velodyne") if kind == "tree" else ("image_02", "velodyne")
    for place, name in enumerate(names):
        image = SAMPLE.image.clone()
        image[:, 0, :place] = 0
        write_image(folder / images / f"{name}.png", image)
        write_points(folder / sweeps / f"{name}.bin", points[: len(points) - place])
        if kind == "tree":
            write_object_calibration(folder / "calib" / f"{name}.txt", mounted)
            (folder / "label_2").mkdir(exist_ok=True)
            labels = LABELS.read_text().replace("561.70", f"561.7{place}")
            (folder / "label_2" / f"{name}.txt").write_text(labels)
    if kind == "drive":
        write_raw_calibration(folder, mounted)
    return root


def mounted_by(tilt):
    return torch.from_numpy(tilt.level_from_lidar.T.copy())


def opened(root, **settings):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        dataset = open_dataset(root, **settings)
    return dataset, [str(each.message) for each in caught]


@KINDS
@pytest.mark.parametrize(("roll_deg", "pitch_deg"), [(3.0, 12.0), (0.0, -8.0), (-10.0, 0.0)])
def test_a_tilted_lidar_is_found_by_the_road_said_once_and_levelled(
    tmp_path, kind, roll_deg, pitch_deg
):
    tilt = Tilt(roll_deg=roll_deg, pitch_deg=pitch_deg)
    write_frames(tmp_path, kind, mounted_by(tilt))
    dataset, (said,) = opened(tmp_path)
    assert "the road in its clouds shows that the LiDAR is tilted, " in said
    sample = dataset[1]
    found = sample.level_from_lidar.numpy()
    assert found[2, :3] @ tilt.up > math.cos(math.radians(1.0))
    assert sample.lidar_height_m == pytest.approx(1.73, abs=0.1)
    (summary,) = summarize_tree(tmp_path)
    assert "by the road in its clouds the LiDAR is tilted, " in str(summary)
    assert list(check_tree(tmp_path)) == []


def test_labels_of_a_tilted_tree_lie_on_their_objects_in_either_frame(tmp_path):
    tilt = Tilt(roll_deg=3.0, pitch_deg=12.0)
    dataset, _ = opened(write_frames(tmp_path, "tree", mounted_by(tilt)))
    objects = level_sample(dataset[0]).objects
    has_box = objects.has_box3d
    found, expected = objects.boxes3d.tensor[has_box], SAMPLE.objects.boxes3d.tensor[has_box]
    # The road, by which the frame was levelled, is level within a degree.
    torch.testing.assert_close(found[:, :3], expected[:, :3], rtol=0.02, atol=0.3)
    torch.testing.assert_close(found[:, 3:], expected[:, 3:], rtol=0, atol=0.02)


@KINDS
def test_every_selection_of_frames_gets_the_same_tilt(tmp_path, kind):
    root = write_frames(tmp_path, kind, mounted_by(Tilt(roll_deg=0.0, pitch_deg=9.0)))
    whole, _ = opened(root)
    one, _ = opened(root, sample_list=("000001",))
    assert torch.equal(one[0].level_from_lidar, whole[1].level_from_lidar)


@KINDS
def test_a_lidar_whose_camera_looks_aside_is_turned_as_in_recordings(tmp_path, kind):
    turn = LEVEL.clone()
    turn[:2, :2] = torch.tensor([[0.0, -1.0], [1.0, 0.0]])
    dataset, said = opened(write_frames(tmp_path, kind, turn))
    assert said == []
    torch.testing.assert_close(level_sample(dataset[0]).points, SAMPLE.points, rtol=0, atol=1e-4)
    (summary,) = summarize_tree(tmp_path)
    assert "degrees (counter-clockwise) from the LiDAR's x axis: detectors get" in str(summary)


@KINDS
def test_level_frames_stay_as_they_are(tmp_path, kind):
    dataset, said = opened(write_frames(tmp_path, kind, LEVEL))
    assert said == []
    assert torch.equal(dataset[0].points, SAMPLE.points)
    assert (dataset[0].level_from_lidar, dataset[0].lidar_height_m) == (None, None)


@KINDS
def test_upturned_clouds_are_told_as_such_and_not_as_tilted(tmp_path, kind):
    upturned = torch.diag(torch.tensor([1.0, -1.0, -1.0, 1.0], dtype=torch.float64))
    dataset, said = opened(write_frames(tmp_path, kind, upturned))
    assert "has its road in the direction z, so that -z points up" in said[-1]
    assert not any("LiDAR is tilted" in each for each in said)
    assert dataset[0].lidar_height_m is None
    problems = [str(problem) for problem in check_tree(tmp_path)]
    assert sum("has its road in the direction z" in problem for problem in problems) == 3


def test_no_frame_of_kitti_is_levelled(kitti_root):
    (drive,) = (kitti_root / "raw").iterdir()
    for root in (kitti_root, drive):
        dataset, said = opened(root)
        assert said == []
        for place in (0, len(dataset) - 1):
            assert dataset[place].level_from_lidar is None
            assert dataset[place].lidar_height_m is None


@pytest.fixture(scope="module")
def poses(kitti_root):
    """Pose by each single cloud of real frames."""
    roots = (kitti_root, *(kitti_root / "raw").iterdir())
    return [pose_of_tree([frame]) for root in roots for frame in open_dataset(root).frames]


def test_no_single_cloud_of_kitti_seems_as_tilted_as_those_that_are_levelled(poses):
    assert all(pose.tilt is None for pose in poses)


def mounted_lower(lower_m):
    moved = LEVEL.clone()
    moved[2, 3] = lower_m
    return moved


@KINDS
@pytest.mark.parametrize("lower_m", [0.9, -1.5, -5.0])
def test_another_height_over_the_road_is_said_once_and_taken(tmp_path, kind, lower_m):
    dataset, (said,) = opened(write_frames(tmp_path, kind, mounted_lower(lower_m)))
    assert dataset[0].lidar_height_m == pytest.approx(1.73 - lower_m, abs=0.15)
    assert dataset[0].level_from_lidar is None
    assert f"the LiDAR is {dataset[0].lidar_height_m:.2f} m above it, not 1.73 m" in said
    assert "lidar_height_m (docs/recordings.md)" in said
    (summary,) = summarize_tree(tmp_path)
    assert "m above it, not 1.73 m like KITTI's" in str(summary)
    assert list(check_tree(tmp_path)) == []


@KINDS
def test_a_height_within_half_a_metre_of_kittis_stays_kittis(tmp_path, kind):
    dataset, said = opened(write_frames(tmp_path, kind, mounted_lower(0.35)))
    assert said == []
    assert dataset[0].lidar_height_m is None


def test_a_height_that_one_of_three_clouds_shows_is_not_taken(tmp_path):
    write_frames(tmp_path, "tree", mounted_lower(0.9))
    for name in ("000001", "000002"):
        cloud = SAMPLE.points[SAMPLE.points[:, 2] > 0]  # no road
        write_points(tmp_path / "training" / "velodyne" / f"{name}.bin", cloud[: -int(name)])
    frames = list(list_object_frames(tmp_path / "training", ("points",)).values())
    assert pose_of_tree(frames).height_m is None
    assert pose_of_tree(frames[:1]).height_m == pytest.approx(0.83, abs=0.15)


@KINDS
def test_trees_whose_clouds_hide_the_road_are_told_unless_a_record_gives_the_mount(tmp_path, kind):
    write_frames(tmp_path, kind, LEVEL)
    told = "clouds show too little of the road to find the LiDAR's height"
    for path in tmp_path.rglob("*.bin"):
        write_points(path, above_road()[: 4000 - int(path.stem)])
    dataset, said = opened(tmp_path)
    (line,) = (each for each in said if told in each)
    assert "with lidar_height_m (docs/recordings.md)" in line
    assert dataset[0].lidar_height_m is None
    (summary,) = summarize_tree(tmp_path)
    assert f"warning: its {told}" in str(summary)
    if kind == "tree":
        record_pose(tmp_path / "training", dataset.pose)
        assert not any(told in each for each in opened(tmp_path)[1])
        (tmp_path / "training" / "lidar_mount.json").unlink()
    for path in tmp_path.rglob("*.bin"):
        write_points(path, above_road()[: 1000 - int(path.stem)])  # as of a fault
    assert not any(told in each for each in opened(tmp_path)[1])


def above_road():
    """Points above the LiDAR's origin."""
    random = torch.Generator().manual_seed(0)
    points = torch.rand(4000, 4, generator=random)
    return points * torch.tensor([30.0, 30, 5, 1]) + torch.tensor([5.0, -15, 1, 0])


def test_a_near_road_in_one_of_three_clouds_is_not_confirmed_by_far_ones(tmp_path):
    write_frames(tmp_path, "tree", mounted_lower(0.9))
    for name in ("000001", "000002"):
        cloud = SAMPLE.points - torch.tensor([0.0, 0, 5, 0])
        write_points(tmp_path / "training" / "velodyne" / f"{name}.bin", cloud[: -int(name)])
    frames = list(list_object_frames(tmp_path / "training", ("points",)).values())
    assert pose_of_tree(frames).height_m is None


def test_no_single_cloud_of_kitti_seems_as_high_or_low_as_those_that_are_moved(poses):
    assert all(pose.height_m is None for pose in poses)


@pytest.mark.parametrize(
    ("height_m", "pitch_deg", "told"),
    [
        (1.73, 0.0, None),
        (1.2, 0.0, "lidar_height_m is 1.2, but the road in the sweeps gives 1."),
        (1.73, 12.0, "lidar_tilt_deg is 12.0 degrees nose down"),
    ],
)
def test_a_mount_of_calibration_files_that_the_road_contradicts_is_told(
    tmp_path, height_m, pitch_deg, told
):
    write_frames(tmp_path, "tree", LEVEL)
    for path in (tmp_path / "training" / "calib").iterdir():
        added = f"lidar_height_m: {height_m}\nlidar_tilt_deg: 0 {pitch_deg}\n"
        path.write_text(path.read_text() + added)
    _, said = opened(tmp_path)
    problems = [str(problem) for problem in check_tree(tmp_path)]
    assert len(said) == (told is not None)
    assert all(f"calib of {tmp_path / 'training'}: {told}" in each for each in said)
    assert len(problems) == (told is not None)
    assert all(f"{tmp_path / 'training' / 'calib'}: {told}" in each for each in problems)


@pytest.mark.parametrize(
    ("height_m", "told"), [(1.73, None), (1.2, "lidar_height_m is 1.2, but the road in the sweeps")]
)
def test_a_drives_calibration_may_give_its_mount(tmp_path, height_m, told):
    write_frames(tmp_path, "drive", LEVEL)
    path = tmp_path / "calib_velo_to_cam.txt"
    path.write_text(f"{path.read_text()}lidar_height_m: {height_m}\nlidar_tilt_deg: 0 1.5\n")
    dataset, said = opened(tmp_path)
    assert dataset[0].lidar_height_m == height_m
    assert dataset[0].level_from_lidar is not None
    problems = [str(problem) for problem in check_tree(tmp_path)]
    assert len(said) == len(problems) == (told is not None)
    assert all(f"{path}: {told}" in each for each in (*said, *problems))

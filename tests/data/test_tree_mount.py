"""LiDARs of KITTI's object trees and raw drives that are mounted tilted, turned or upside down."""

import math
import shutil
import warnings

import pytest
import torch

from sightline.data.check import check_tree, summarize_tree
from sightline.data.kitti_files import (
    write_image,
    write_object_calibration,
    write_points,
    write_raw_calibration,
)
from sightline.data.open import open_dataset
from sightline.data.tree_mount import pose_of_tree
from sightline.geometry.calibration import Calibration
from sightline.geometry.tilt import Tilt
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.structures.level import level_sample
from tests.data.recordings import SAMPLE

LEVEL = torch.eye(4, dtype=torch.float64)
LABELS = PACKAGED_FRAMES / "training" / "label_2" / "000000.txt"
KINDS = pytest.mark.parametrize("kind", ["tree", "drive"])


def write_frames(root, kind, mounted_from_level, *, names=("000000", "000001", "000002")):
    """The same frame again and again, of a LiDAR that is mounted so, with its calibration."""
    points = SAMPLE.points.clone()
    points[:, :3] = (points[:, :3].double() @ mounted_from_level[:3, :3].T).float()
    mounted = Calibration(
        image_from_camera=SAMPLE.calibration.image_from_camera,
        camera_from_lidar=SAMPLE.calibration.camera_from_lidar @ mounted_from_level.T,
    )
    folder = root / "training" if kind == "tree" else root
    images, sweeps = ("image_2", "velodyne") if kind == "tree" else ("image_02", "velodyne")
    for name in names:
        write_image(folder / images / f"{name}.png", SAMPLE.image)
        write_points(folder / sweeps / f"{name}.bin", points)
        if kind == "tree":
            write_object_calibration(folder / "calib" / f"{name}.txt", mounted)
            (folder / "label_2").mkdir(exist_ok=True)
            shutil.copy(LABELS, folder / "label_2" / f"{name}.txt")
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
    assert "by the road in its clouds the LiDAR is tilted, " in said
    sample = dataset[1]
    found = sample.level_from_lidar.numpy()
    assert found[2, :3] @ tilt.up > math.cos(math.radians(1.0))
    assert sample.lidar_height_m == pytest.approx(1.73, abs=0.1)
    (summary,) = summarize_tree(tmp_path)
    assert "by the road that it sees the LiDAR is tilted, " in str(summary)
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
    assert "degrees (counter-clockwise) from the LiDAR's x axis: detectors see" in str(summary)


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


def test_no_single_cloud_of_kitti_seems_as_tilted_as_those_that_are_levelled(kitti_root):
    for root in (kitti_root, *(kitti_root / "raw").iterdir()):
        frames = open_dataset(root).frames
        assert all(pose_of_tree([frame]).tilt is None for frame in frames)

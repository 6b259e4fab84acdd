import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from sightline.data.check import check_tree
from sightline.data.datasets.kitti_depth import KittiDepthDataset
from sightline.data.datasets.kitti_raw import KittiRawDrive
from sightline.data.formats.map_png import read_instance_png
from sightline.files.problem import FileError
from sightline.geometry.transforms import transform_points
from sightline.jobs.run import JobResult
from sightline.simulation.generate import DriveLayout
from sightline.simulation.rigs import named_rig
from sightline.simulation.settings import SimulationConfig
from tests.simulation.data_sets import DRIVES, content, make


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("drives")
    assert make(out, 5, DRIVES, workers=1) == JobResult(written=5, skipped=0)
    return out


def test_drives_pass_the_check_as_recordings_and_as_depth_tree(drives: Path):
    assert list(check_tree(drives, num_workers=1)) == []
    day = drives / "2000_01_01"
    for folder in sorted(day.glob("*_sync")):
        assert list(check_tree(folder, num_workers=1)) == []
    depth = KittiDepthDataset(drives, "train")
    assert len(depth) == 5
    assert depth[0].depth is not None


def test_the_poses_of_a_drive_bring_standing_points_to_the_same_place(drives: Path):
    folder = drives / "2000_01_01/2000_01_01_drive_0000_sync"
    drive = KittiRawDrive(folder, folder / "poses.txt")
    assert [sample.timestamp_s for sample in drive] == pytest.approx([0.0, 0.1, 0.2])
    for sample in drive:
        points = sample.points[:, :3].double()
        world = transform_points(sample.world_from_lidar, points)
        walls = world[(world[:, :2].abs().amax(dim=1) > 29) & (world[:, 2] > 0.5)]
        assert len(walls) > 1000
        # The inner faces of the courtyard's walls stand 29.8 m away in the world.
        assert (walls[:, :2].abs().amax(dim=1) - 29.8).abs().median() < 0.02
    first, last = drive[0].world_from_lidar, drive[2].world_from_lidar
    assert torch.linalg.vector_norm(last[:3, 3] - first[:3, 3]) > 0.15


def test_a_drive_cut_short_is_extended_with_its_poses_and_times(drives: Path, tmp_path: Path):
    make(tmp_path, 2, DRIVES, workers=1)
    make(tmp_path, 5, DRIVES, workers=2)
    assert content(tmp_path) == content(drives)


def test_labels_of_a_drive_follow_its_frames(drives: Path):
    folder = drives / "2000_01_01/2000_01_01_drive_0001_sync"
    names = sorted(path.stem for path in (folder / "label_02/data").glob("*.txt"))
    assert names == ["0000000000", "0000000001"]
    instances = read_instance_png(folder / "instance/data/0000000001.png")
    assert instances.shape == DRIVES.image_size


def test_parts_of_drives_are_whole_drives(drives: Path, tmp_path: Path):
    options = {"workers": 1, "num_shards": 2}
    assert make(tmp_path, 5, DRIVES, shard_index=1, **options) == JobResult(written=2, skipped=0)
    (recording,) = (tmp_path / "2000_01_01").glob("*_sync")
    assert (recording / "poses.txt").is_file()
    assert make(tmp_path, 5, DRIVES, shard_index=0, **options) == JobResult(written=3, skipped=0)
    assert content(tmp_path) == content(drives)


def test_sweeps_that_a_drive_cannot_have_are_no_frames_that_were_begun(
    drives: Path, tmp_path: Path
):
    shutil.copytree(drives, tmp_path, dirs_exist_ok=True)
    recordings = tmp_path / "2000_01_01"
    data = recordings / "2000_01_01_drive_0001_sync/velodyne_points/data"
    for name in ("9999999999", "99999999999999999999", "mine"):
        (data / f"{name}.bin").touch()
    (recordings / "2000_01_01_drive_99999999_sync").mkdir()
    (recordings / "2000_01_01_drive_mine_sync").mkdir()
    assert make(tmp_path, 5, DRIVES, workers=1) == JobResult(written=0, skipped=5)


def test_a_drive_far_beyond_what_was_begun_is_refused_by_name_and_changes_nothing(
    drives: Path, tmp_path: Path
):
    shutil.copytree(drives, tmp_path, dirs_exist_ok=True)
    stray = tmp_path / "2000_01_01/2000_01_01_drive_9999_sync/velodyne_points/data/0000000001.bin"
    stray.parent.mkdir(parents=True)
    stray.touch()
    calibration = tmp_path / "2000_01_01/calib_velo_to_cam.txt"
    before, written = content(tmp_path), calibration.stat().st_mtime_ns
    message = r"is the sweep of frame 29998, expected an index below 9000 .* 29999 frames"
    with pytest.raises(FileError, match=rf"drive_9999_sync.*0000000001\.bin: {message}"):
        make(tmp_path, 5, DRIVES, workers=1)
    assert content(tmp_path) == before
    assert calibration.stat().st_mtime_ns == written


def test_the_last_of_a_thousand_parts_that_began_a_drive_is_in_the_plan_of_any_later_run(
    tmp_path: Path,
):
    layout = DriveLayout(root=tmp_path, sequence_length=100)
    last = 999 * 100
    layout.frame(last).points.parent.mkdir(parents=True)
    layout.frame(last).points.touch()
    assert layout.num_planned(1) == last + 1


def test_drives_are_not_reduced_or_split(tmp_path: Path):
    with pytest.raises(ValueError, match="keep to that"):
        make(tmp_path, 2, DRIVES, velodyne="velodyne_reduced")


def test_drives_are_not_made_without_the_camera(tmp_path: Path):
    with pytest.raises(ValueError, match="drives have images"):
        make(tmp_path, 2, replace(DRIVES, camera=False))


def test_drives_of_another_rig_give_their_lidars_mount(tmp_path: Path):
    make(tmp_path, 1, SimulationConfig(sequence_length=2, rig=named_rig("robot-vlp16")), workers=1)
    sample = KittiRawDrive(next((tmp_path / "2000_01_01").glob("*_sync")))[0]
    assert sample.lidar_height_m == 1.25
    assert sample.level_from_lidar is not None

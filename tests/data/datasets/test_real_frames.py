"""The real frames that SIGHTLINE_KITTI names; skipped where it is unset."""

import numpy as np
import pytest
import torch

from sightline.data.check import check_tree
from sightline.data.datasets.kitti_object import KittiObjectDataset
from sightline.data.datasets.kitti_raw import KittiRawDrive
from sightline.data.formats.image_header import read_image_size
from sightline.data.formats.kitti_conversion import kitti_from_labels, labels_from_kitti
from sightline.data.formats.kitti_files import (
    read_object_calibration,
    read_points,
    read_raw_calibration,
    write_object_calibration,
    write_points,
)
from sightline.data.formats.kitti_labels import read_labels, write_objects
from sightline.geometry.projection import project_points


@pytest.fixture(scope="module")
def dataset(kitti_root):
    return KittiObjectDataset(kitti_root)


@pytest.fixture(scope="module")
def drive(kitti_root):
    folder = kitti_root / "raw" / "2011_09_26_drive_0052_sync"
    if not folder.is_dir():
        pytest.skip(f"{folder} is not there")
    return KittiRawDrive(folder, poses=folder / "poses_velo_kiss_icp.txt")


def test_all_frames_are_read_whole(dataset, kitti_root):
    assert len(dataset) == len(list((kitti_root / "training" / "calib").iterdir()))
    for sample in dataset:
        assert tuple(sample.image.shape[1:]) == sample.image_size
        assert len(sample.points) > 10_000
        assert 0 <= sample.points[:, 3].min() <= sample.points[:, 3].max() <= 1
        assert len(sample.objects) > 0
        # The clouds are the reduced ones: cut to the points that the camera sees.
        seen = project_points(sample.points[:, :3], sample.calibration).in_image(sample.image_size)
        assert seen.double().mean() > 0.99


def test_the_check_finds_no_problem(kitti_root):
    assert [str(problem) for problem in check_tree(kitti_root)] == []


def test_points_inside_a_3d_box_fall_in_its_2d_box(kitti_root):
    inside = total = 0
    for sample in KittiObjectDataset(kitti_root, parts=("points", "objects")):
        objects = sample.objects.select(sample.objects.has_box3d)
        pixels = project_points(sample.points[:, :3].double(), sample.calibration).pixels
        contained = objects.boxes3d.contain(sample.points[:, :3].double())
        for box, mask in zip(objects.boxes2d.tensor, contained, strict=True):
            held = pixels[mask]
            inside += ((held >= box[:2] - 0.5) & (held <= box[2:] + 0.5)).all(dim=1).sum().item()
            total += len(held)
    assert total > 10_000
    assert inside / total >= 0.95


def test_labels_survive_the_way_through_the_projects_types_byte_by_byte(kitti_root, tmp_path):
    for path in sorted((kitti_root / "training" / "label_2").iterdir()):
        calibration = read_object_calibration(kitti_root / "training" / "calib" / path.name)
        labels = labels_from_kitti(read_labels(path), calibration)
        write_objects(tmp_path / path.name, kitti_from_labels(labels, calibration))
        assert (tmp_path / path.name).read_bytes() == path.read_bytes()


def test_calibrations_and_sweeps_survive_writing_and_reading(kitti_root, tmp_path):
    for path in sorted((kitti_root / "training" / "calib").iterdir())[:10]:
        original = read_object_calibration(path)
        write_object_calibration(tmp_path / path.name, original)
        again = read_object_calibration(tmp_path / path.name)
        assert torch.equal(again.image_from_lidar, original.image_from_lidar)
        sweep = path.parents[1] / "velodyne" / f"{path.stem}.bin"
        write_points(tmp_path / sweep.name, read_points(sweep))
        assert (tmp_path / sweep.name).read_bytes() == sweep.read_bytes()


def test_sizes_from_headers_are_those_of_the_pixels(dataset, kitti_root):
    for index in range(0, len(dataset), 10):
        sample = dataset[index]
        path = kitti_root / "training" / "image_2" / f"{sample.sample_id}.png"
        assert read_image_size(path) == sample.image_size


def test_whole_sweeps_hold_the_reduced_ones(kitti_root):
    for path in sorted((kitti_root / "full_sweeps").glob("*.bin"))[:2]:
        whole = {tuple(point) for point in read_points(path).tolist()}
        reduced = read_points(kitti_root / "training" / "velodyne" / path.name)
        assert {tuple(point) for point in reduced.tolist()} <= whole


def test_a_drives_frames_are_consecutive_and_its_poses_move_ahead(drive):
    assert len(drive) == 78
    positions = np.array([sample.world_from_lidar[:3, 3].numpy() for sample in drive])
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    assert steps.max() < 4  # 10 Hz in a town
    assert positions[-1, 0] > 5


def test_the_raw_calibration_is_that_of_the_same_moments_object_frame(drive, kitti_root):
    object_calibration = read_object_calibration(kitti_root / "training" / "calib" / "001497.txt")
    raw = read_raw_calibration(drive.folder)
    for name in ("image_from_camera", "camera_from_lidar"):
        torch.testing.assert_close(
            getattr(raw, name), getattr(object_calibration, name), rtol=0, atol=1e-6
        )
    frame = KittiObjectDataset(kitti_root, sample_list=["001497"])[0]
    assert torch.equal(drive[7].image, frame.image)

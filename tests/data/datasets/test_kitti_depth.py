import shutil

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from sightline.data.check import check_tree
from sightline.data.datasets.kitti_depth import KittiDepthDataset, points_from_depth_map
from sightline.data.formats.image_file import write_rgb
from sightline.data.formats.map_png import write_depth_png
from sightline.data.open import open_dataset
from sightline.geometry.calibration import Calibration
from sightline.geometry.projection import sparse_depth_map
from tests.data.trees import (
    IMAGE_SIZE,
    depth_map,
    picture,
    write_depth_drive,
    write_selection,
)

steps = arrays.arrays(np.uint16, arrays.array_shapes(min_dims=2, max_dims=2, max_side=40))


def test_the_points_project_to_the_same_sparse_map_value_for_value(tmp_path):
    write_selection(tmp_path)
    (sample,) = KittiDepthDataset(tmp_path)
    again = sparse_depth_map(sample.points, sample.calibration, sample.image_size)
    assert torch.equal(again, torch.from_numpy(depth_map()))
    assert len(sample.points) == np.count_nonzero(depth_map())
    assert not sample.points[:, 3].any()


@given(
    values=steps,
    focal=st.floats(50, 5000),
    aspect=st.floats(0.5, 2),
    centre=st.tuples(st.floats(-50, 2000), st.floats(-50, 2000)),
)
def test_any_camera_projects_its_own_points_back_to_the_pixels_they_came_from(
    values, focal, aspect, centre
):
    intrinsics = torch.tensor(
        [[focal, 0, centre[0], 0], [0, aspect * focal, centre[1], 0], [0, 0, 1, 0]],
        dtype=torch.float64,
    )
    camera_from_lidar = torch.tensor(
        [[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]], dtype=torch.float64
    )
    calibration = Calibration(image_from_camera=intrinsics, camera_from_lidar=camera_from_lidar)
    depth_m = torch.from_numpy((values / 256).astype(np.float32))
    points = points_from_depth_map(depth_m, calibration)
    assert torch.equal(sparse_depth_map(points, calibration, tuple(depth_m.shape)), depth_m)


def test_a_sample_of_the_cropped_selection_holds_image_and_ground_truth(tmp_path):
    name = write_selection(tmp_path)
    dataset = KittiDepthDataset(tmp_path)
    assert (
        dataset.sample_ids == (name,) == ("2011_09_26_drive_0002_sync_image_0000000005_image_02",)
    )
    assert torch.equal(dataset[0].image, torch.from_numpy(picture()).permute(2, 0, 1))
    assert torch.equal(dataset[0].depth, torch.from_numpy(depth_map(1)))
    assert dataset[0].image_size == IMAGE_SIZE
    assert dataset[0].calibration.image_from_camera[0].tolist() == [20.0, 0.0, 19.5, 0.0]


def test_the_selection_is_found_from_the_base_folder_its_own_and_itself(tmp_path):
    write_selection(tmp_path)
    for root in (tmp_path, tmp_path / "depth_selection"):
        assert len(KittiDepthDataset(root)) == 1
    assert len(KittiDepthDataset(tmp_path / "depth_selection" / "val_selection_cropped")) == 1


def test_the_anonymous_test_split_has_no_ground_truth(tmp_path):
    write_selection(tmp_path)
    base = tmp_path / "depth_selection"
    shutil.rmtree(base / "val_selection_cropped" / "groundtruth_depth")
    (base / "val_selection_cropped").rename(base / "test_depth_completion_anonymous")
    for folder in (base / "test_depth_completion_anonymous").iterdir():
        for path in folder.iterdir():
            path.rename(folder / f"0000000000{path.suffix}")
    (sample,) = KittiDepthDataset(tmp_path, "test_depth_completion_anonymous")
    assert sample.sample_id == "0000000000"
    assert sample.depth is None
    assert len(sample.points) == np.count_nonzero(depth_map())


def test_drives_take_images_and_intrinsics_from_the_raw_recordings(tmp_path):
    name = write_depth_drive(tmp_path / "depth", tmp_path / "raw")
    dataset = KittiDepthDataset(tmp_path / "depth", "val", raw_root=tmp_path / "raw")
    assert dataset.sample_ids == (name,)
    sample = dataset[0]
    assert torch.equal(sample.image, torch.from_numpy(picture()).permute(2, 0, 1))
    assert torch.equal(sample.depth, torch.from_numpy(depth_map(1)))
    # The baseline of the rectified projection stays out: depth maps are in the camera's own frame.
    assert not sample.calibration.image_from_camera[:, 3].any()
    again = sparse_depth_map(sample.points, sample.calibration, sample.image_size)
    assert torch.equal(again, torch.from_numpy(depth_map()))


def test_all_archives_may_be_extracted_to_one_folder(tmp_path):
    name = write_depth_drive(tmp_path, tmp_path)
    for archive in ("data_depth_annotated", "data_depth_velodyne"):
        shutil.copytree(tmp_path / archive, tmp_path, dirs_exist_ok=True)
        shutil.rmtree(tmp_path / archive)
    assert KittiDepthDataset(tmp_path, "val").sample_ids == (name,)


def test_images_and_calibration_may_lie_in_the_drives_of_a_depth_tree(tmp_path):
    name = write_depth_drive(tmp_path, tmp_path / "raw")
    expected = KittiDepthDataset(tmp_path, "val", raw_root=tmp_path / "raw")[0]
    shutil.move(tmp_path / "data_depth_annotated" / "val", tmp_path / "val")
    drive = tmp_path / "val" / name.split("_image_")[0]
    day = tmp_path / "raw" / "2011_09_26"
    shutil.copytree(day / drive.name, drive, dirs_exist_ok=True)
    shutil.copyfile(day / "calib_cam_to_cam.txt", drive / "calib_cam_to_cam.txt")
    for path in (tmp_path, tmp_path / "val"):
        sample = open_dataset(path)[0]
        assert list(check_tree(path)) == []
        assert torch.equal(sample.image, expected.image)
        matrices = sample.calibration.image_from_camera, expected.calibration.image_from_camera
        assert torch.equal(*matrices)
    shutil.copytree(day, tmp_path / day.name)
    write_rgb(tmp_path / day.name / drive.name / "image_02/data/0000000005.png", picture(3))
    sample = KittiDepthDataset(tmp_path, "val")[0]
    assert torch.equal(sample.image, torch.from_numpy(picture(3)).permute(2, 0, 1))


def test_frames_lacking_an_image_are_named_unless_none_are_wanted(tmp_path):
    name = write_depth_drive(tmp_path, tmp_path)
    shutil.rmtree(tmp_path / "2011_09_26" / name.split("_image_")[0])
    with pytest.raises(ValueError, match=rf"image lacks 1 of 1 frames \({name}\); extract"):
        KittiDepthDataset(tmp_path, "val")
    (sample,) = KittiDepthDataset(tmp_path, "val", load_images=False)
    (tmp_path / "2011_09_26" / "calib_cam_to_cam.txt").unlink()
    with pytest.raises(ValueError, match=r"intrinsics \(calib_cam_to_cam.txt\) lacks 1 of 1"):
        KittiDepthDataset(tmp_path, "val", load_images=False)
    assert sample.image is None
    assert sample.image_size == IMAGE_SIZE


@pytest.mark.parametrize(
    ("folder", "complaint"),
    [
        ("velodyne_raw", "velodyne_raw lacks 1 of 2"),
        ("groundtruth_depth", "groundtruth lacks 1 of 2"),
        ("intrinsics", "intrinsics lacks 1 of 2"),
        ("image", "image lacks 1 of 2"),
    ],
)
def test_a_frame_lacking_a_part_says_which(tmp_path, folder, complaint):
    write_selection(tmp_path, "0000000005")
    write_selection(tmp_path, "0000000008")
    next(tmp_path.rglob(f"{folder}/*0000000008*")).unlink()
    with pytest.raises(ValueError, match=rf"{complaint} frames \(.*0000000008_image_02\)"):
        KittiDepthDataset(tmp_path)


def test_an_image_or_a_truth_of_another_size_is_named_with_both_sizes(tmp_path):
    name = write_selection(tmp_path)
    image = next(tmp_path.rglob(f"image/{name}.png"))
    write_rgb(image, picture(size=(12, 41)))
    with pytest.raises(ValueError, match=rf"{image}: is 12x41 .* expected 12x40 like .*velodyne"):
        KittiDepthDataset(tmp_path)[0]
    truth = next(tmp_path.rglob("groundtruth_depth/*.png"))
    write_depth_png(truth, depth_map(size=(13, 40)))
    with pytest.raises(ValueError, match=rf"{truth}: is 13x40 .* expected 12x40"):
        KittiDepthDataset(tmp_path, load_images=False)[0]


def test_a_folder_without_frames_is_refused_by_name(tmp_path):
    for split in ("train", "val", "val_selection_cropped", "test_depth_completion_anonymous"):
        with pytest.raises(ValueError, match=rf"{tmp_path} holds no frames of {split}"):
            KittiDepthDataset(tmp_path, split)


def test_a_sparse_map_without_a_value_is_a_sweep_of_zero_points(tmp_path):
    write_selection(tmp_path)
    write_depth_png(next(tmp_path.rglob("velodyne_raw/*.png")), np.zeros(IMAGE_SIZE))
    assert KittiDepthDataset(tmp_path)[0].points.shape == (0, 4)

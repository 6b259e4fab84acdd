import re
import shutil
import warnings
from pathlib import Path

import numpy as np
import pytest

from sightline.data.check import check_tree, summarize_tree
from sightline.data.datasets.kitti_depth import KittiDepthDataset
from sightline.data.datasets.kitti_object import KittiObjectDataset
from sightline.data.datasets.kitti_raw import KittiRawDrive
from sightline.data.datasets.sample_files import describe_sparse_maps, warn_of_missing_sensors
from sightline.data.formats.map_png import write_depth_png
from sightline.data.open import open_dataset
from sightline.data.sharding import write_shards
from sightline.files.problem import FileError
from tests.data.recordings import write_recording
from tests.data.trees import IMAGE_SIZE, write_depth_drive, write_drive
from tests.data.trees import write_object_tree as write_whole_object_tree
from tests.data.trees import write_selection as write_selected
from tests.inference.trees import write_object_tree

DRIVE = "2011_09_26_drive_0002_sync"
INTRINSICS = "721.5 0 609.5 0 721.5 172.8 0 0 1\n"


def write_selection(folder, *, with_truth):
    kinds = ["image", "velodyne_raw"] + ["groundtruth_depth"] * with_truth
    for kind in kinds:
        name = f"{DRIVE}_{kind}_0000000005_image_02" if with_truth else "0000000005"
        write_depth_png(folder / kind / f"{name}.png", np.ones((4, 6)))
    name = f"{DRIVE}_image_0000000005_image_02" if with_truth else "0000000005"
    (folder / "intrinsics").mkdir()
    (folder / "intrinsics" / f"{name}.txt").write_text(INTRINSICS)


def test_raw_drives_beside_a_depth_tree_are_told(tmp_path):
    write_depth_drive(tmp_path, tmp_path)
    dataset = open_dataset(tmp_path)
    assert isinstance(dataset, KittiDepthDataset)
    parts = ("image", "points")
    warn_of_missing_sensors(dataset, tmp_path, parts)  # warnings are errors
    assert describe_sparse_maps(dataset, tmp_path) == (
        f"{tmp_path} is a depth completion tree, whose sparse depth maps are used as sweeps"
    )
    drive = write_drive(tmp_path / "2011_09_26" / "2011_09_26_drive_0003_sync")
    warn_of_missing_sensors(dataset, tmp_path, parts, needs_sweeps=False)
    said = f"for whole sweeps give one of its raw drives (1), such as {drive}"
    with pytest.warns(UserWarning, match=re.escape(said)):
        warn_of_missing_sensors(dataset, tmp_path, parts)
    assert said in str(summarize_tree(tmp_path)[0])
    assert describe_sparse_maps(open_dataset(drive), drive) is None


def test_an_object_tree_is_known_by_its_root_and_by_its_split(tmp_path):
    write_object_tree(tmp_path, 3)
    for path in (tmp_path, tmp_path / "training"):
        dataset = open_dataset(path, parts=("points",))
        assert isinstance(dataset, KittiObjectDataset)
        assert dataset.sample_ids == ("000000", "000001", "000002")


def test_a_split_is_known_from_inside_it_and_through_a_link(tmp_path, monkeypatch):
    write_object_tree(tmp_path, 2)
    (tmp_path / "link").symlink_to(tmp_path / "training")
    monkeypatch.chdir(tmp_path / "training")
    for path in (Path(), tmp_path / "link"):
        assert isinstance(open_dataset(path, parts=("points",)), KittiObjectDataset)


@pytest.mark.parametrize("name", ["training", "testing"])
def test_a_whole_object_tree_is_known_in_a_folder_with_the_name_of_a_split(tmp_path, name):
    write_object_tree(tmp_path / name, 3)
    shards = tmp_path / "shards" / name
    write_shards(tmp_path / name, shards, frames_per_shard=2)
    for path in (tmp_path / name, tmp_path / name / "training", shards, shards / "training"):
        dataset = open_dataset(path, parts=("points",))
        assert dataset.sample_ids == ("000000", "000001", "000002")


def test_training_comes_before_testing_unless_testing_is_named(tmp_path):
    write_object_tree(tmp_path, 2)
    (tmp_path / "elsewhere").mkdir()
    write_object_tree(tmp_path / "elsewhere", 1)
    (tmp_path / "elsewhere" / "training").rename(tmp_path / "testing")
    told = "only the frames in training are used, not the 1 in testing; give .*testing"
    with pytest.warns(UserWarning, match=told):
        assert len(open_dataset(tmp_path, parts=("points",))) == 2
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(open_dataset(tmp_path / "testing")) == 1
        assert len(open_dataset(tmp_path, sample_list=["000001"])) == 1


@pytest.mark.parametrize(
    ("place", "with_truth"),
    [
        ("val_selection_cropped", True),
        ("depth_selection/val_selection_cropped", True),
        ("test_depth_completion_anonymous", False),
    ],
)
def test_a_depth_selection_is_known_by_its_own_folder_and_those_above(tmp_path, place, with_truth):
    write_selection(tmp_path / place, with_truth=with_truth)
    for path in (tmp_path, tmp_path / place):
        dataset = open_dataset(path, parts=("points",))
        assert isinstance(dataset, KittiDepthDataset)
        assert dataset.split == place.split("/")[-1]
        assert len(dataset[0].points) == 24
        assert (dataset[0].depth is not None) == with_truth


@pytest.mark.parametrize("split", ["val", "train"])
def test_annotated_drives_are_known_by_their_split_and_the_folder_above(tmp_path, split):
    maps = tmp_path / split / DRIVE / "proj_depth"
    for kind in ("velodyne_raw", "groundtruth"):
        write_depth_png(maps / kind / "image_02" / "0000000005.png", np.ones((4, 6)))
    (tmp_path / DRIVE[:10]).mkdir()
    matrix = "P_rect_02: 721.5 0 609.5 0 0 721.5 172.8 0 0 0 1 0\n"
    (tmp_path / DRIVE[:10] / "calib_cam_to_cam.txt").write_text(matrix)
    for path in (tmp_path, tmp_path / split):
        dataset = open_dataset(path, parts=("points",))
        assert isinstance(dataset, KittiDepthDataset)
        assert dataset.sample_ids == (f"{DRIVE}_image_0000000005_image_02",)


def copy_to_other_camera(root):
    for path in sorted(root.rglob("proj_depth/*/image_02/*.png")):
        folder = path.parent.parent / "image_03"
        folder.mkdir(exist_ok=True)
        shutil.copy(path, folder)


def test_the_splits_of_a_depth_tree_that_are_not_opened_are_told(tmp_path):
    write_depth_drive(tmp_path, tmp_path, "train")
    write_depth_drive(tmp_path, tmp_path)
    told = rf"{tmp_path}: only the frames in val are used, not the 1 in train; "
    with pytest.warns(
        UserWarning, match=told + r"KittiDepthDataset\(.., split\) reads those in Py"
    ):
        open_dataset(tmp_path)
    for archive in ("data_depth_annotated", "data_depth_velodyne"):
        shutil.copytree(tmp_path / archive, tmp_path, dirs_exist_ok=True)
        shutil.rmtree(tmp_path / archive)
    train = tmp_path / "train"
    with pytest.warns(
        UserWarning, match=told + f"give the folder of another split, such as {train}"
    ):
        (name,) = open_dataset(tmp_path).sample_ids
    for path, names in ((train, None), (tmp_path / "val", None), (tmp_path, [name])):
        assert open_dataset(path, sample_list=names).sample_ids == (name,)  # warnings are errors
    write_selected(tmp_path)
    write_selection(tmp_path / "test_depth_completion_anonymous", with_truth=False)
    told = (
        "only the frames in val_selection_cropped are used, not the 1 in train, 1 in val, 1 in "
        "test_depth_completion_anonymous; give the folder"
    )
    with pytest.warns(UserWarning, match=told):
        open_dataset(tmp_path, parts=("points",))
    assert len(open_dataset(tmp_path / "depth_selection" / "val_selection_cropped")) == 1


def test_the_right_cameras_frames_of_a_depth_tree_are_told(tmp_path):
    name = write_depth_drive(tmp_path, tmp_path)
    copy_to_other_camera(tmp_path)
    told = (
        rf"{tmp_path}: only the frames of image_02 in val are used, not the 1 of image_03; "
        r'KittiDepthDataset\(.., "val", cameras=\("image_03",\)\) reads those in Python'
    )
    with pytest.warns(UserWarning, match=told):
        assert open_dataset(tmp_path).sample_ids == (name,)
    assert len(open_dataset(tmp_path, sample_list=[name])) == 1
    other = f"{name[:-1]}3"
    with pytest.warns(UserWarning, match=told), pytest.raises(ValueError, match=f"lacks .*{other}"):
        open_dataset(tmp_path, sample_list=[other])
    assert len(KittiDepthDataset(tmp_path, "val", cameras=("image_03",), load_images=False)) == 1
    assert "; other commands leave out the 1 of image_03" in str(summarize_tree(tmp_path)[0])


def test_a_list_picks_samples_of_any_tree_in_its_order(tmp_path):
    write_object_tree(tmp_path / "objects", 3)
    write_selection(tmp_path / "depth", with_truth=False)
    listed = open_dataset(tmp_path / "objects", sample_list=["000002", "000000"], parts=("points",))
    assert listed.sample_ids == ("000002", "000000")
    listed = open_dataset(tmp_path / "depth", sample_list=["0000000005"], parts=("points",))
    assert (len(listed), listed[0].sample_id) == (1, "0000000005")
    with pytest.raises(ValueError, match=r"lacks 1 of the requested frames, x: there are 1, from"):
        open_dataset(tmp_path / "depth", sample_list=["x"], parts=("points",))


@pytest.mark.parametrize("layout", ["recording", "drive", "objects"])
def test_changing_a_sample_changes_no_other_frame(tmp_path, layout):
    if layout == "recording":
        folder = write_recording(tmp_path / "rec", ("a", "b"), cloud=".npy", picture=".png")
    elif layout == "drive":
        folder = write_drive(tmp_path / "2011_09_26" / "drive", 2)
    else:
        folder = write_object_tree(tmp_path, 2)
    dataset = open_dataset(folder)
    expected = dataset[1]
    first = dataset[0]
    for matrix in (first.calibration.image_from_camera, first.world_from_lidar):
        if matrix is not None:
            matrix[:2] *= 0.5  # as for an image of half the size
    assert dataset[1] == expected
    assert dataset[0] != first


def test_a_split_that_is_a_link_to_another_disk_is_a_split(tmp_path):
    write_object_tree(tmp_path, 1)
    split = tmp_path / "training"
    split.rename(tmp_path / "elsewhere")
    split.symlink_to("elsewhere")
    assert not list(check_tree(split))
    write_shards(split, tmp_path / "shards", frames_per_shard=1)
    assert open_dataset(split).sample_ids == open_dataset(tmp_path / "shards").sample_ids


def test_an_object_split_under_another_name_is_refused_with_the_remedy(tmp_path):
    write_object_tree(tmp_path, 1)
    (tmp_path / "training").rename(tmp_path / "mine")
    told = "mine: holds the parts of an object split; rename it to training or testing"
    with pytest.raises(ValueError, match=told):
        open_dataset(tmp_path / "mine")
    assert [told in str(each) for each in check_tree(tmp_path / "mine")] == [True]
    shutil.rmtree(tmp_path / "mine" / "image_2")
    with pytest.raises(ValueError, match=told):
        open_dataset(tmp_path / "mine", parts=("points",))


def test_a_raw_drive_whose_images_are_in_image_2_is_called_so(tmp_path):
    drive = write_drive(tmp_path / DRIVE, official=False)
    (drive / "image_02").rename(drive / "image_2")
    told = r"image_2: holds 3 files that are not read, expected them in image_02; rename"
    with pytest.raises(FileError, match=told):
        open_dataset(drive)
    (problem,) = check_tree(drive)
    assert re.search(told, str(problem))


@pytest.mark.parametrize("part", ["image", "points"])
def test_gaps_of_a_needed_sensor_in_a_drive_are_found_before_the_work(tmp_path, part):
    drive = write_drive(tmp_path / DRIVE, official=False)
    folder = drive / {"image": "image_02", "points": "velodyne"}[part]
    next(folder.glob("0000000001.*")).unlink()
    nouns = {"image": "images", "points": "point clouds"}
    told = rf"lacks {nouns[part]} of 1 of 3 frames \(0000000001\); add them or name a list"
    with pytest.raises(ValueError, match=told):
        open_dataset(drive, parts=("image", "points"), needs=(part,))
    others = ["0000000000", "0000000002"]
    settings = {"parts": ("image", "points"), "sample_list": others}
    for needs in ((part,), None):
        assert open_dataset(drive, needs=needs, **settings).sample_ids == tuple(others)
    with pytest.raises(ValueError, match=r"lacks .* of 1 of 3 frames .* add them or name a list"):
        open_dataset(drive, parts=("image", "points"), sample_list=["0000000001", *others])
    assert len(open_dataset(drive, parts=("image", "points"), needs=())) == 3


def test_gaps_of_a_depth_tree_are_only_those_of_the_list(tmp_path):
    lacking, whole = (write_selected(tmp_path, name) for name in ("0000000005", "0000000008"))
    next(tmp_path.rglob("groundtruth_depth/*05_image_02.png")).unlink()
    folder = tmp_path / "depth_selection"
    with pytest.raises(ValueError, match=r"groundtruth lacks 1 of 2 frames .* or name a list"):
        open_dataset(folder, parts=("image", "points", "depth"))
    settings = {"parts": ("image", "points", "depth"), "sample_list": [whole]}
    assert open_dataset(folder, **settings)[0].depth is not None
    with pytest.raises(ValueError, match=rf"lacks true depth of 1 of 1 frames \({lacking}\)"):
        open_dataset(folder, **{**settings, "sample_list": [lacking]})


def test_folders_that_are_no_data_set_are_refused(tmp_path):
    with pytest.raises(ValueError, match="nowhere: does not exist"):
        open_dataset(tmp_path / "nowhere")
    with pytest.raises(ValueError, match="is no data set, expected a recording"):
        open_dataset(tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(ValueError, match="file: is no folder"):
        open_dataset(tmp_path / "file")


def test_a_real_drive_and_the_real_frames_open(kitti_root):
    drive = open_dataset(kitti_root / "raw" / "2011_09_26_drive_0052_sync")
    assert isinstance(drive, KittiRawDrive)
    assert len(drive) == 78
    assert len(open_dataset(kitti_root, sample_list="sample_val")) == 29


@pytest.mark.filterwarnings("ignore:.*no images. their size is guessed")
@pytest.mark.parametrize("folder", ["image_2", "velodyne", "label_2"])
def test_whatever_part_is_missing_the_rest_is_opened_where_nothing_is_asked_for(tmp_path, folder):
    write_whole_object_tree(tmp_path, "000001", "000002")
    shutil.rmtree(tmp_path / "training" / folder)
    samples = list(open_dataset(tmp_path))
    attribute = {"image_2": "image", "velodyne": "points", "label_2": "objects"}[folder]
    held = {"image", "points", "objects"} - {attribute}
    for sample in samples:
        assert getattr(sample, attribute) is None
        assert all(getattr(sample, name) is not None for name in held)


def test_a_frame_whose_camera_failed_is_a_sample_without_an_image_of_the_others_size(tmp_path):
    write_whole_object_tree(tmp_path, "000001", "000002")
    (tmp_path / "training" / "image_2" / "000002.png").unlink()
    first, second = open_dataset(tmp_path, parts=("image", "points"), needs=("points",))
    assert first.image is not None
    assert second.image is None
    assert second.image_size == first.image_size
    with pytest.raises(ValueError, match=r"lacks image_2 of 1 of 2 frames \(000002\)"):
        open_dataset(tmp_path, parts=("image", "points"))


def test_without_any_picture_the_principal_point_is_taken_for_the_centre(tmp_path):
    write_whole_object_tree(tmp_path / "objects", "000001")
    shutil.rmtree(tmp_path / "objects" / "training" / "image_2")
    drive = write_drive(tmp_path / "drive", official=False)
    shutil.rmtree(drive / "image_02")
    for path in (tmp_path / "objects", drive):
        with pytest.warns(UserWarning, match="no images: their size is guessed") as warned:
            assert open_dataset(path)[0].image_size == IMAGE_SIZE
        assert len(warned) == 1
        (summary,) = summarize_tree(path)
        assert "no images: their size is guessed by the principal point, 12x40" in str(summary)


def test_reduced_sweeps_are_not_taken_for_none(tmp_path):
    write_whole_object_tree(tmp_path, "000001")
    (tmp_path / "training" / "velodyne").rename(tmp_path / "training" / "velodyne_reduced")
    assert open_dataset(tmp_path)[0].points is not None
    assert open_dataset(tmp_path, parts=("points",))[0].points is not None
    with pytest.raises(ValueError, match="lacks velodyne"):
        open_dataset(tmp_path, parts=("points",), velodyne="velodyne")


def test_reduced_sweeps_of_a_drive_are_refused(tmp_path):
    drive = write_drive(tmp_path / "drive", official=False)
    assert len(open_dataset(drive, velodyne="velodyne"))
    with pytest.raises(ValueError, match="velodyne_reduced is a folder of KITTI's object trees"):
        open_dataset(drive, velodyne="velodyne_reduced")


@pytest.mark.filterwarnings("ignore:.*only the frames in training are used")
def test_each_split_has_sweeps_of_its_own(tmp_path):
    write_whole_object_tree(tmp_path, "000001")
    shutil.copytree(tmp_path / "training", tmp_path / "testing")
    (tmp_path / "training" / "velodyne").rename(tmp_path / "training" / "velodyne_reduced")
    for path in (tmp_path, tmp_path / "training", tmp_path / "testing"):
        assert open_dataset(path)[0].points is not None


def test_calibrations_and_labels_of_frames_that_are_not_there_are_no_frames(tmp_path):
    write_whole_object_tree(tmp_path, "000001", "000002")
    for name in ("image_2/000002.png", "velodyne/000002.bin"):
        (tmp_path / "training" / name).unlink()
    assert open_dataset(tmp_path).sample_ids == ("000001",)


def test_labels_whose_names_are_not_those_of_the_frames_are_told(tmp_path):
    write_whole_object_tree(tmp_path, "000001", "000002")
    labels = tmp_path / "training" / "label_2"
    shutil.copy(labels / "000001.txt", labels / "000007.txt")
    assert all(sample.objects is not None for sample in open_dataset(tmp_path))  # as of more frames
    for name in ("000001", "000002"):
        (labels / f"{name}.txt").rename(labels / f"0000{name}.txt")
    said = (
        r"label_2: has 3 files that belong to no frame \(0000000001, 0000000002, 000007\), and 2 "
        r"of 2 frames have no labels \(000001, 000002\); give labels the names"
    )
    with pytest.warns(UserWarning, match=said) as warned:
        assert all(sample.objects is None for sample in open_dataset(tmp_path))
    assert len(warned) == 1
    open_dataset(tmp_path, parts=("image", "points"), needs=())  # without labels no word


@pytest.mark.parametrize("name", ["label_all", "labels", "label_0", "Label_velo"])
def test_a_folder_of_labels_of_another_name_is_told(tmp_path, name):
    write_whole_object_tree(tmp_path, "000001", "000002")
    (tmp_path / "training" / "label_2").rename(tmp_path / "training" / name)
    said = f"{name}: holds 2 files that are not read, expected them in label_2"
    with pytest.warns(UserWarning, match=said):
        open_dataset(tmp_path)
    assert any(said in str(each) for each in check_tree(tmp_path))


@pytest.mark.parametrize("place", [".", "000001.tar"])
def test_a_tar_that_is_longer_than_its_index_is_told_by_check_and_on_opening(tmp_path, place):
    write_whole_object_tree(tmp_path / "data", "000001", "000002")
    shards = tmp_path / "shards"
    write_shards(tmp_path / "data", shards, frames_per_shard=1)
    before, tar = list(check_tree(shards / place)), shards / "000001.tar"
    length = tar.stat().st_size
    tar.write_bytes(tar.read_bytes() + bytes(10240))
    said = f"000001.tar: is {length + 10240} bytes long, expected {length} by its index; copy it"
    problem, *others = check_tree(shards / place)
    assert said in str(problem)
    assert others == before
    with pytest.warns(UserWarning, match=said):
        open_dataset(shards / place)

import re
import shutil
import tarfile
from pathlib import Path

import pytest

from sightline.data.check import check_tree, summarize_tree
from sightline.data.formats.image_file import write_rgb
from sightline.data.formats.kitti_files import write_points
from sightline.data.open import open_dataset
from sightline.data.sharding import write_shards
from sightline.files.problem import FileError
from tests.data.recordings import write_recording
from tests.data.trees import (
    picture,
    points,
    write_depth_drive,
    write_drive,
    write_object_frame,
    write_object_tree,
)


def told(root) -> str:
    """The one problem of a folder, by check and by whoever opens it alike."""
    (problem,) = check_tree(root)
    with pytest.raises(FileError) as caught:
        open_dataset(root)
    assert caught.value.problem == problem
    return str(problem)


def write_odometry(folder):
    write_object_tree(folder, "000000")
    (folder / "training" / "calib" / "000000.txt").rename(folder / "training" / "calib.txt")
    (folder / "training" / "calib").rmdir()
    (folder / "training").rename(folder / "00")
    return folder / "00"


def test_a_sequence_of_odometry_is_called_so_with_what_to_do(tmp_path):
    sequence = write_odometry(tmp_path / "sequences")
    line = told(sequence)
    assert "is a sequence of KITTI odometry: one calib.txt, with P2 and Tr" in line
    assert "rename image_2 to images and velodyne to points" in line
    assert "times.txt" not in line
    (sequence / "times.txt").write_text("0.000000e+00\n")  # as each of KITTI's sequences has
    assert "and begin each line of times.txt with its frame's name" in told(sequence)
    assert f"{sequence} in it looks like one; give that folder" in told(tmp_path)


@pytest.mark.parametrize(
    ("images", "said"),
    [
        ("image_0", "rename image_0 to images and velodyne to points, .* numbers of P0, and cam"),
        (
            None,
            "rename velodyne to points, and .* P2, image_size, that of the camera's images, and",
        ),
    ],
)
def test_grey_images_and_sweeps_alone_of_odometry_have_their_own_remedies(tmp_path, images, said):
    sequence = write_odometry(tmp_path)
    if images is None:
        shutil.rmtree(sequence / "image_2")
    else:
        (sequence / "image_2").rename(sequence / images)
    assert re.search(said, told(sequence))


def test_tracking_is_called_so(tmp_path):
    for folder in ("image_02/0000", "label_02", "calib", "velodyne/0000"):
        (tmp_path / "training" / folder).mkdir(parents=True)
    assert "is a split of KITTI tracking" in told(tmp_path)
    assert "is a split of KITTI tracking" in told(tmp_path / "training")


def test_kitti_360_is_called_so_whatever_lies_in_its_calibration(tmp_path):
    for name in ("calibration", "data_2d_raw", "data_3d_raw"):
        (tmp_path / name).mkdir()
    (tmp_path / "calibration" / "perspective.txt").write_text("P_rect_00: 1\n")
    assert "is a KITTI-360 data set" in told(tmp_path)


def test_folders_of_kitti_360_are_called_so_until_they_are_recordings(tmp_path):
    drive = "2013_05_28_drive_0000_sync"
    pictures, sweeps = tmp_path / "data_2d_raw" / drive, tmp_path / "data_3d_raw" / drive
    (tmp_path / "calibration").mkdir()
    write_rgb(pictures / "image_00/data_rect/0000000000.png", picture())
    write_rgb(pictures / "image_02/data_rgb/0000000000.png", picture())
    write_points(sweeps / "velodyne_points/data/0000000000.bin", points())
    for folder in (pictures, sweeps, pictures.parent, sweeps.parent, tmp_path / "calibration"):
        assert "is a KITTI-360 data set" in told(folder)
    (sweeps / "velodyne_points/data").rename(sweeps / "points")
    assert "holds images or points without a calibration" in told(sweeps)
    write_recording(sweeps.with_name("done"))
    assert list(check_tree(sweeps.with_name("done"))) == []
    assert list(check_tree(write_drive(sweeps.with_name("raw_drive")))) == []


def test_the_test_of_depth_prediction_is_called_so(tmp_path):
    folder = tmp_path / "depth_selection" / "test_depth_prediction_anonymous"
    write_rgb(folder / "image" / "0000000000.png", picture())
    (folder / "intrinsics").mkdir()
    assert "like the test of KITTI's depth prediction; make it a recording" in told(folder)
    assert f"{folder} in it looks like one" in told(tmp_path)


def test_pictures_with_labels_alone_are_found_below(tmp_path):
    folder = tmp_path / "Kitti" / "raw"  # as torchvision stores them
    write_object_tree(folder, "000000")
    for name in ("velodyne", "calib"):
        shutil.rmtree(folder / "training" / name)
    assert f"{folder} in it looks like one; give that folder" in told(tmp_path)


def test_a_recording_with_folders_of_kittis_names_stays_one(tmp_path):
    write_recording(tmp_path / "one")
    (tmp_path / "one" / "label_2").mkdir()
    (tmp_path / "one" / "label_2" / "a.txt").touch()
    told_of = [str(each) for each in check_tree(tmp_path / "one")]
    assert len(told_of) == 1
    assert "label_2: holds 1 files that are not read, expected them in labels" in told_of[0]
    write_recording(tmp_path / "other")
    (tmp_path / "other" / "calib").mkdir()
    (tmp_path / "other" / "calibration.yaml").rename(tmp_path / "other" / "calib" / "a.yaml")
    assert "calib: holds 1 files that are not read, expected them in calibration" in told(
        tmp_path / "other"
    )


def test_a_folder_that_is_read_is_named_before_one_of_another_benchmark(tmp_path):
    selection = tmp_path / "archives" / "depth_selection"
    for name in ("image", "intrinsics"):
        (selection / "test_depth_prediction_anonymous" / name).mkdir(parents=True)
    prediction = selection / "test_depth_prediction_anonymous"
    assert f"{prediction} in it looks like one; give that folder" in told(tmp_path / "archives")
    for name in ("image", "velodyne_raw"):
        (selection / "val_selection_cropped" / name).mkdir(parents=True)
    sound = selection / "val_selection_cropped"
    assert f"{sound} in it looks like one; give that folder" in told(tmp_path / "archives")


def test_a_folder_above_a_data_set_names_it(tmp_path):
    write_object_tree(tmp_path / "kitti" / "object", "000000")
    assert f"{tmp_path / 'kitti' / 'object'} in it looks like one" in told(tmp_path)
    write_recording(tmp_path / "other")
    assert ", and 1 more; give that folder" in told(tmp_path)
    for name in ("training", "testing"):
        write_recording(tmp_path / "mine" / name)
        write_object_frame(tmp_path / "trees" / "mine", "000000", name)
    place = tmp_path / "mine" / "testing"
    assert f"{place} in it looks like one, and 1 more; give that folder" in told(tmp_path / "mine")
    place = tmp_path / "trees" / "mine"
    assert f"{place} in it looks like one; give that folder" in told(tmp_path / "trees")
    write_object_frame(tmp_path / "export", "000000", "mini_train")
    said = told(tmp_path / "export")
    assert "mini_train: holds the parts of an object split; rename it to training" in said


def test_archives_unpacked_apart_and_not_unpacked_are_told(tmp_path):
    for part in ("image_2", "velodyne"):
        (tmp_path / f"data_object_{part}" / "training" / part).mkdir(parents=True)
    assert "holds KITTI's archives unpacked into separate folders (data_object_image_2" in told(
        tmp_path
    )
    (tmp_path / "zips").mkdir()
    (tmp_path / "zips" / "data_object_calib.zip").write_bytes(b"PK")
    assert "archives that are not unpacked, such as data_object_calib.zip" in told(
        tmp_path / "zips"
    )


def test_shards_without_their_list_are_told_as_such(tmp_path):
    (tmp_path / "000000.tar").write_bytes(b"")
    assert "archives that are not unpacked, such as 000000.tar" in told(tmp_path)
    (tmp_path / "000000.json").write_text("{}")
    assert "holds shards without shards.json, the list of them; copy the whole" in told(tmp_path)
    (tmp_path / "shards.json").write_text("{")
    assert "holds shards whose list, shards.json, is damaged; copy the whole" in told(tmp_path)


@pytest.mark.parametrize("write", [write_recording, lambda data: write_object_tree(data, "000000")])
@pytest.mark.parametrize("compress", [True, False])
def test_shards_without_their_indexes_are_told_as_such(tmp_path, write, compress):
    write(tmp_path / "data")
    write_shards(tmp_path / "data", tmp_path / "out", frames_per_shard=2, compress=compress)
    for path in (tmp_path / "out").glob("*.json"):
        path.unlink()
    remedy = "copy the whole folder again, or pack the data again (sightline shard)"
    assert told(tmp_path / "out") == (
        f"{tmp_path / 'out'}: holds shards of `sightline shard` without their indexes, such as "
        f"000000.tar without 000000.json; {remedy}"
    )
    assert told(tmp_path / "out" / "000000.tar") == (
        f"{tmp_path / 'out' / '000000.tar'}: is a shard of `sightline shard` without its index, "
        f"000000.json beside it; {remedy}"
    )


@pytest.mark.parametrize(
    ("name", "mtime"), [("training/image_2/000000.png", 0), ("000000.image.png", 1)]
)
def test_other_tars_are_archives_to_unpack(tmp_path, name, mtime):
    with tarfile.open(tmp_path / "000000.tar", "w") as archive:
        member = tarfile.TarInfo(name)
        member.mtime = mtime
        archive.addfile(member)
    assert "archives that are not unpacked, such as 000000.tar" in told(tmp_path)
    assert "000000.tar: is an archive; unpack it, and give" in told(tmp_path / "000000.tar")


@pytest.mark.parametrize("name", ["v1.0-mini/scene.json", "drive.mcap", "drive.bag"])
def test_what_an_import_takes_is_told_to_be_imported(tmp_path, name):
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_bytes(b"")
    assert "convert it to a recording: sightline import" in told(tmp_path)


def test_a_sensor_alone_in_another_format_is_named(tmp_path):
    (tmp_path / "training" / "image_2").mkdir(parents=True)
    for name in ("000000.bmp", "000001.bmp", "000002"):
        (tmp_path / "training" / "image_2" / name).write_bytes(b"BM")
    assert "image_2: holds 3 files that are not read (2 .bmp, 1 without an ending)" in told(
        tmp_path
    )


def test_labels_of_a_raw_drive_are_said_not_to_be_read(tmp_path):
    drive = write_drive(tmp_path / "drive")
    (drive / "tracklet_labels.xml").write_text("<x/>")
    (summary,) = summarize_tree(drive)
    assert "tracklet_labels.xml is not read" in str(summary)


def test_a_part_of_a_depth_tree_is_called_so_and_its_split_named(tmp_path, monkeypatch):
    write_depth_drive(tmp_path, tmp_path)
    split = tmp_path / "data_depth_annotated" / "val"
    drive = split / "2011_09_26_drive_0002_sync"
    monkeypatch.chdir(drive)
    for place in (
        drive,
        drive / "proj_depth",
        drive / "proj_depth" / "groundtruth" / "image_02",
        Path(),
    ):
        line = told(place)
        assert "is a part of a depth completion tree, but none of its splits" in line
        assert line.endswith(f"give the split, {split}")
    other = split.rename(tmp_path / "mine")
    assert told(other).endswith(f"rename {other} to train or val, as in KITTI's tree")


def test_empty_folders_of_a_known_layout_have_no_frames(tmp_path):
    for name in ("images", "points", "calibration"):
        (tmp_path / "recording" / name).mkdir(parents=True)
    assert "there are no files in images/ and points/" in told(tmp_path / "recording")
    for name in ("image_2", "velodyne", "calib"):
        (tmp_path / "tree" / "training" / name).mkdir(parents=True)
    expected = "has no frames: there are no files in training/image_2/ and training/velodyne/"
    assert expected in told(tmp_path / "tree")
    archive = tmp_path / "tree" / "data_object_image_2.zip"
    archive.touch()
    assert "archives that are not unpacked, such as data_object_image_2" in told(tmp_path / "tree")
    archive.unlink()
    (tmp_path / "tree" / "training" / "image_2" / "notes").mkdir()
    assert expected not in told(tmp_path / "tree")

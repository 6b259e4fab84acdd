import shutil
from pathlib import Path

import pytest

from sightline.data.check import check_tree
from sightline.data.formats.image_file import write_rgb
from sightline.data.layouts.kitti_trees import list_drive
from sightline.data.open import open_dataset
from sightline.data.sharding import write_shards
from sightline.files.problem import FileError
from tests.data.checks.test_drive_calibration import told
from tests.data.trees import picture, write_drive


@pytest.mark.parametrize("official", [True, False], ids=["official", "flat"])
@pytest.mark.parametrize("empty", ["image_02/data", "velodyne_points/data"])
def test_files_beside_an_empty_folder_are_read(tmp_path, empty, official):
    folder = write_drive(tmp_path / "day" / "drive", official=official)
    part = "image_02" if "image" in empty else "velodyne_points"
    if official:
        for path in list((folder / empty).iterdir()):
            path.rename(folder / part / path.name)
    (folder / empty).mkdir(exist_ok=True, parents=True)
    assert told(folder) == []
    for sample in open_dataset(folder):
        assert sample.image is not None
        assert sample.points is not None


def test_a_drive_without_files_of_a_part_names_the_folder_that_exists(tmp_path):
    folder = write_drive(tmp_path / "drive")
    shutil.rmtree(folder / "image_02" / "data")
    assert list_drive(folder).image_folder == folder / "image_02"
    (folder / "image_02").rmdir()
    assert list_drive(folder).image_folder == folder / "image_02" / "data"


@pytest.mark.parametrize(
    ("read", "other", "kept"),
    [
        ("image_02/data", "image_02", 1),
        ("velodyne_points/data", "velodyne_points", 2),
        ("velodyne_points/data", "velodyne", 3),
    ],
)
def test_files_in_a_second_place_are_told_with_their_number(tmp_path, read, other, kept):
    folder = write_drive(tmp_path / "drive")
    (folder / other).mkdir(exist_ok=True)
    for path in sorted((folder / read).iterdir())[:kept]:
        shutil.copy(path, folder / other)
    assert told(folder) == [
        f"{folder / other}: holds {kept} files that are not read, because {folder / read} has "
        "some, too; keep those of one folder, and move the others away"
    ]


def other_camera(folder: Path, name: str) -> Path:
    """Give a drive three images of another camera."""
    for number in range(3):
        write_rgb(folder / name / f"{number:010}.png", picture(10 + number))
    return folder


@pytest.mark.parametrize("name", ["image_03/data", "image_00", "image_01/data"])
def test_images_of_another_camera_alone_are_told(tmp_path, name):
    folder = other_camera(write_drive(tmp_path / "drive"), name)
    assert told(folder) == []  # KITTI's drives have all four
    shutil.rmtree(folder / "image_02")
    (line,) = told(folder)
    assert line.startswith(f"{folder / name}: holds 3 images that are not read: only those of ")
    assert "camera 02 are, and " in line
    with pytest.warns(UserWarning, match="no images: their size is guessed") as warned:
        open_dataset(folder, parts=("points",), needs=("points",))
    assert len(warned) == 1


def test_a_drive_of_another_camera_without_sweeps_is_told_so(tmp_path):
    folder = other_camera(write_drive(tmp_path / "drive"), "image_03/data")
    for name in ("image_02", "velodyne_points"):
        shutil.rmtree(folder / name)
    expected = "image_03/data: holds 3 images that are not read"
    with pytest.raises(ValueError, match=expected):
        open_dataset(folder)
    (problem,) = check_tree(folder)
    assert expected in str(problem)


def test_the_calibration_of_a_linked_drive_is_found_beside_the_link_or_its_target(tmp_path):
    folder = write_drive(tmp_path / "2011_09_26" / "2011_09_26_drive_0001_sync")
    link = tmp_path / "links" / "drive"
    link.parent.mkdir()
    link.symlink_to(folder)
    assert told(link) == []
    assert list_drive(link).calibration == folder.parent
    assert len(open_dataset(link)) == 3
    with pytest.raises(FileError, match=rf"pack the folder of its day, {folder.parent}, or copy"):
        write_shards(link, tmp_path / "shards", frames_per_shard=2)
    for path in folder.parent.glob("calib_*.txt"):
        shutil.copy(path, link.parent)
    assert list_drive(link).calibration == link.parent
    assert told(link) == []
    other = folder.parent / "calib_velo_to_cam.txt"
    other.write_text("R: 1 0 0 0 1 0 0 0 1\nT: 0.5 0.5 0.5\n")
    (line,) = told(link)
    assert line.startswith(f"{link.parent / other.name}: is used, but {other}, one folder up, has")

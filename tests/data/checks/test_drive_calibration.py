import shutil
import warnings
from pathlib import Path

import pytest

from sightline.data.check import check_tree
from sightline.data.formats.image_file import write_rgb
from sightline.data.formats.kitti_calibration import read_stated_size
from sightline.data.open import open_dataset
from tests.data.trees import picture, write_drive

P_RECT = "20 0 19.5 1.25 0 20 5.5 0 0 0 1 0"  # of 40x12 pixels, as `write_drive` has them


def told(folder: Path) -> list[str]:
    """Problems of `check`, which opening the drive tells as well."""
    problems = [str(problem) for problem in check_tree(folder)]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        open_dataset(folder, needs=())
    warned = [str(each.message) for each in caught]
    for problem in problems:
        assert any(each.startswith(problem) for each in warned), (problem, warned)
    return problems


def resized_drive(
    folder: Path, size: tuple[int, int], *, p_rect: str = P_RECT, sizes: str = ""
) -> Path:
    """A drive whose images have another size than most, with sizes in its calibration."""
    write_drive(folder, official=False)
    for number, path in enumerate(sorted((folder / "image_02").iterdir())):
        write_rgb(path, picture(number, size))
    path = folder / "calib_cam_to_cam.txt"
    lines = path.read_text().splitlines()
    kept = [line for line in lines if not line.startswith("P_rect_02")]
    path.write_text("\n".join((*kept, f"P_rect_02: {p_rect}", sizes, "")))
    return folder


@pytest.mark.parametrize(
    ("size", "p_rect", "doubt"),
    [
        ((6, 20), P_RECT, "in the middle of an image of 12x40 (height x width), but images are 6x"),
        ((24, 80), P_RECT, "for another resolution; scale its first two rows, or the images"),
        ((12, 40), P_RECT.replace("19.5", "4"), "has its principal point at (4, 5.5), away from"),
    ],
)
@pytest.mark.parametrize("sizes", ["", "S_rect_02: 4.0e+01 1.2e+01"])
def test_a_camera_matrix_of_other_images_is_told_once(tmp_path, size, p_rect, doubt, sizes):
    (line,) = told(resized_drive(tmp_path / "drive", size, p_rect=p_rect, sizes=sizes))
    assert line.startswith(f"{tmp_path / 'drive' / 'calib_cam_to_cam.txt'}: ")
    assert doubt in line


def test_images_of_another_size_than_the_calibration_states_are_told_with_both(tmp_path):
    adapted = P_RECT.replace("5.5", "9.5")  # so the matrix itself fits
    folder = resized_drive(
        tmp_path / "drive", (20, 40), p_rect=adapted, sizes="S_02: 50 30\nS_rect_02: 40 12"
    )
    (line,) = told(folder)
    assert line.startswith(f"{folder}/image_02/0000000000.png: is 40x20 (width x height), but ")
    assert "but S_rect_02 of " in line
    assert "calib_cam_to_cam.txt states 40x12 for rectified images" in line
    assert "let P_rect_02 and S_rect_02 both be of their new size" in line


def test_images_that_are_not_rectified_are_told_so(tmp_path):
    sizes = "S_02: 5.0e+01 1.6e+01\nS_rect_02: 4.0e+01 1.2e+01"
    (line,) = told(resized_drive(tmp_path / "drive", (16, 50), sizes=sizes))
    assert "as it has the size S_02, it is probably not rectified; take the images of the _" in line


@pytest.mark.parametrize("sizes", ["", "S_02: 50 16", "S_02: 50 16\nS_rect_02: 41 12"])
def test_a_size_that_is_not_stated_or_is_close_gets_no_word(tmp_path, sizes):
    assert told(resized_drive(tmp_path / "drive", (12, 40), sizes=sizes)) == []


def test_a_stated_size_that_is_no_size_is_told(tmp_path):
    (line,) = told(resized_drive(tmp_path / "drive", (12, 40), sizes="S_rect_02: 40"))
    assert "calib_cam_to_cam.txt: S_rect_02 holds 1 values, expected 2 numbers (1x2)" in line


@pytest.mark.parametrize("name", ["calib_cam_to_cam.txt", "calib_velo_to_cam.txt"])
def test_two_calibrations_of_a_drive_that_differ_are_told_with_the_one_that_is_used(tmp_path, name):
    folder = write_drive(tmp_path / "day" / "drive")
    day = folder.parent
    for path in day.glob("calib_*.txt"):
        shutil.copy(path, folder)
    assert told(folder) == []
    text = (folder / name).read_text()
    (folder / name).write_text("calib_time: 09-Jan-2012 13:57:47\n" + text)
    assert told(folder) == []
    entry, *words = (folder / name).read_text().splitlines()[-1].split()
    for word, same in ((float(words[0]) * (1 + 1e-7), True), (float(words[0]) + 0.01, False)):
        lines = (day / name).read_text().splitlines()
        changed = " ".join((entry, str(word), *words[1:]))
        (day / name).write_text("\n".join((*lines[:-1], changed, "")))
        lines = told(folder)
        assert len(lines) == (not same)
    assert lines == [
        f"{folder / name}: is used, but {day / name}, one folder up, has other values and is not "
        "read; remove the wrong one of the two"
    ]


def test_the_days_calibration_is_found_from_within_the_drive(tmp_path, monkeypatch):
    folder = write_drive(tmp_path / "day" / "drive")
    monkeypatch.chdir(folder)
    assert told(Path()) == []
    monkeypatch.chdir(folder / "image_02")
    assert told(Path("..")) == []


def test_kittis_own_sizes_are_read(kitti_root):
    (path,) = (kitti_root / "raw").glob("*/calib_cam_to_cam.txt")
    assert read_stated_size(path, "S_rect_02") == (375, 1242)
    assert read_stated_size(path, "S_02") == (512, 1392)
    assert read_stated_size(path, "S_09") is None

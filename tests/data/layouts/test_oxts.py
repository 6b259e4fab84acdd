import math
from pathlib import Path

import numpy as np
import pytest

from sightline.data.check import check_tree
from sightline.data.datasets.kitti_raw import KittiRawDrive
from sightline.data.layouts.drive_poses import read_oxts_poses
from tests.data.datasets.test_kitti_raw import oxts, write_readings
from tests.data.trees import write_drive

METRE = 1.0 / (math.radians(1) * 6378137.0)  # in degrees of latitude


def drive_with_readings(folder: Path, *lines: str, flat: bool = False) -> Path:
    """A drive with a reading for each frame, at 10 Hz where it is not flat."""
    write_drive(folder, len(lines), official=not flat)
    readings = folder / "oxts" if flat else folder / "oxts" / "data"
    readings.mkdir(parents=True)
    _, mounting = write_readings(readings, *lines)
    mounting.rename((folder if flat else folder.parent) / mounting.name)
    return folder


def told(folder: Path) -> str:
    """The one problem of `check`, which refuses the poses, too."""
    (problem,) = check_tree(folder)
    with pytest.raises(ValueError, match="oxts") as raised:
        KittiRawDrive(folder, poses="oxts")
    assert str(raised.value) == str(problem)
    return str(problem)


@pytest.mark.parametrize(
    ("reading", "complaint"),
    [
        (oxts(latitude=-91.0), "has the latitude -91.0, expected degrees between -90 and 90"),
        (oxts(longitude=180.5), "has the longitude 180.5, expected degrees from -180 to 180"),
        (oxts(roll=-7.0), "has the roll -7.0, expected radians from -2 pi to 2 pi: it is prob"),
        (oxts(pitch=90.0), "has the pitch 90.0, expected radians"),
        (oxts(yaw=179.0), "has the yaw 179.0, expected radians"),
    ],
)
def test_readings_out_of_range_are_refused_by_file_and_field(tmp_path, reading, complaint):
    folder = drive_with_readings(tmp_path / "day" / "drive", oxts(), reading)
    assert f"{folder}/oxts/data/0000000001.txt: {complaint}" in told(folder)


@pytest.mark.parametrize(
    ("flat", "north_m", "limit"),
    [
        (False, 9.0, ""),
        (False, 11.0, "at most 10 m in 0.1 s"),
        (True, 49.0, ""),
        (True, 51.0, "at most 50 m"),
    ],
)
def test_positions_that_jump_are_refused_with_both_files(tmp_path, flat, north_m, limit):
    lines = (oxts(), oxts(), oxts(latitude=49.0 + north_m * METRE))
    folder = drive_with_readings(tmp_path / "day" / "drive", *lines, flat=flat)
    if not limit:
        assert list(check_tree(folder)) == []
        assert len(KittiRawDrive(folder, poses="oxts")) == 3
        return
    line = told(folder)
    place = folder / "oxts" if flat else folder / "oxts" / "data"
    assert line.startswith(f"{place}/0000000002.txt: lies {north_m:.4g} m from the frame before it")
    assert f"{place}/0000000001.txt, expected {limit}; correct the readings or name a" in line


def test_lost_frames_allow_longer_steps_and_the_date_line_is_no_jump(tmp_path):
    lines = (oxts(longitude=179.9999), oxts(longitude=-179.9999))
    paths, mounting = write_readings(tmp_path, *lines)
    step_m = 2e-4 * math.cos(math.radians(49.0)) / METRE
    np.testing.assert_allclose(read_oxts_poses(paths, mounting)[1][0, 3], step_m, rtol=1e-6)
    paths[1].write_text(oxts(longitude=-179.999))
    with pytest.raises(ValueError, match="lies 80"):
        read_oxts_poses(paths, mounting)
    later = paths[1].rename(tmp_path / "0000000002.txt")
    assert len(read_oxts_poses([paths[0], later], mounting)) == 2
    named = later.rename(tmp_path / "b.txt")
    with pytest.raises(ValueError, match="expected at most 50 m"):
        read_oxts_poses([paths[0], named], mounting)


def test_times_that_stand_still_do_not_refuse_a_position(tmp_path):
    paths, mounting = write_readings(tmp_path, oxts(), oxts(latitude=49.0 + 20 * METRE))
    assert len(read_oxts_poses(paths, mounting, (0.0, 0.0))) == 2
    assert len(read_oxts_poses(paths, mounting, (0.0, 0.3))) == 2
    with pytest.raises(ValueError, match=r"at most 10 m in 0\.01 s"):
        read_oxts_poses(paths, mounting, (0.0, 0.01))


def test_readings_of_zeros_are_told_by_check_and_on_opening(tmp_path):
    zeros = " ".join(["0"] * 30)
    folder = drive_with_readings(tmp_path / "day" / "drive", zeros, zeros)
    (problem,) = check_tree(folder)
    assert "oxts/data: holds only zeros for place and direction in all 2 readings" in str(problem)
    with pytest.warns(UserWarning, match="holds only zeros") as caught:
        KittiRawDrive(folder, poses="oxts")
    assert [str(each.message) for each in caught] == [str(problem)]
    KittiRawDrive(folder)  # an error if it warned


def test_missing_readings_are_counted(tmp_path):
    folder = drive_with_readings(tmp_path / "day" / "drive", *[oxts()] * 3)
    for number in (1, 2):
        (folder / "oxts" / "data" / f"{number:010}.txt").unlink()
    line = told(folder)
    assert (
        "oxts/data: lacks the readings of 2 of 3 frames (0000000001, 0000000002), expected" in line
    )


def test_readings_in_a_flat_layout_and_with_capital_endings_are_read(tmp_path):
    folder = drive_with_readings(tmp_path / "drive", oxts(), oxts(altitude=111.0), flat=True)
    (folder / "oxts" / "data").mkdir()
    path = folder / "oxts" / "0000000001.txt"
    path.rename(path.with_suffix(".TXT"))
    (folder / "oxts" / "timestamps.txt").write_text("")
    assert list(check_tree(folder)) == []
    drive = KittiRawDrive(folder, poses="oxts")
    assert drive[1].world_from_lidar[2, 3].item() == pytest.approx(1.0)

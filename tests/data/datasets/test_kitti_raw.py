import math
import pickle
import re
import shutil

import numpy as np
import pytest
import torch

from sightline.data.check import check_tree
from sightline.data.datasets.kitti_raw import KittiRawDrive
from sightline.data.formats.image_file import write_rgb
from sightline.data.layouts.drive_poses import read_oxts_poses, read_poses
from sightline.data.layouts.drive_times import read_timestamps
from tests.data.trees import calibration, picture, points, write_drive

IDENTITY = "1 0 0 0 0 1 0 0 0 0 1 0"


@pytest.mark.parametrize("official", [True, False], ids=["official", "flat"])
def test_frames_follow_each_other_in_both_layouts(tmp_path, official):
    folder = write_drive(tmp_path / "day" / "drive", official=official)
    next(folder.rglob("0000000000.bin")).write_bytes(b"")
    drive = KittiRawDrive(folder)
    assert drive.sample_ids == ("0000000000", "0000000001", "0000000002")
    for number, sample in enumerate(drive):
        assert sample.sample_id == drive.sample_ids[number]
        assert torch.equal(sample.image, torch.from_numpy(picture(number)).permute(2, 0, 1))
        assert torch.equal(sample.points, points(24 + number if number else 0))
        assert torch.equal(sample.calibration.image_from_lidar, calibration().image_from_lidar)
        assert sample.world_from_lidar is None
    assert len(drive[0].points) == 0  # a sweep of zero points is a sweep


def test_times_are_seconds_since_the_first_frame_where_the_drive_has_them(tmp_path):
    official = KittiRawDrive(write_drive(tmp_path / "day" / "drive"))
    assert [sample.timestamp_s for sample in official] == pytest.approx([0, 0.1, 0.2])
    flat = KittiRawDrive(write_drive(tmp_path / "flat", official=False))
    assert flat[0].timestamp_s is None


@pytest.mark.parametrize(("lost", "times"), [("0000000001", [0, 0.2]), ("0000000000", [0, 0.1])])
def test_a_time_belongs_to_its_number_where_frames_were_lost(tmp_path, lost, times):
    folder = write_drive(tmp_path / "day" / "drive")
    (folder / "image_02" / "data" / f"{lost}.png").unlink()
    (folder / "velodyne_points" / "data" / f"{lost}.bin").unlink()
    drive = KittiRawDrive(folder)
    assert [sample.timestamp_s for sample in drive] == pytest.approx(times)


def test_frames_named_without_leading_zeros_are_in_the_order_of_their_numbers(tmp_path):
    folder = write_drive(tmp_path / "drive", num_frames=1, official=False)
    for number in (10, 9):
        for place, end in (("image_02", "png"), ("velodyne", "bin")):
            shutil.copy(folder / place / f"0000000000.{end}", folder / place / f"{number}.{end}")
    for place, end in (("image_02", "png"), ("velodyne", "bin")):
        (folder / place / f"0000000000.{end}").unlink()
    assert KittiRawDrive(folder).sample_ids == ("9", "10")


def test_too_few_times_are_refused_by_name(tmp_path):
    folder = write_drive(tmp_path / "day" / "drive")
    (folder / "velodyne_points" / "timestamps.txt").write_text("2011-09-26 13:02:25.5\n")
    with pytest.raises(ValueError, match=r"timestamps\.txt: holds 1 times, expected one") as raised:
        KittiRawDrive(folder)
    assert str(raised.value) in [str(problem) for problem in check_tree(folder)]


def test_a_file_of_poses_gives_each_frame_its_own(tmp_path):
    folder = write_drive(tmp_path / "drive", official=False)
    rows = [f"1 0 0 {number} 0 1 0 0 0 0 1 0" for number in (5, 6, 7)]
    (tmp_path / "poses.txt").write_text("\n".join(rows) + "\n")
    drive = KittiRawDrive(folder, poses=tmp_path / "poses.txt")
    assert [sample.world_from_lidar[0, 3].item() for sample in drive] == [5, 6, 7]


def test_poses_that_do_not_fit_the_frames_are_refused_by_name(tmp_path):
    folder = write_drive(tmp_path / "drive", official=False)
    path = tmp_path / "poses.txt"
    for text, complaint in (
        (IDENTITY, r"poses\.txt: holds 1 poses, expected one for each of the 3 frames"),
        ("1 0 0", r"poses\.txt: line 1 holds 3 values, expected the 12"),
        (IDENTITY + "\n" + IDENTITY.replace("1", "2"), r"poses\.txt: line 2: .* no rotation"),
        (IDENTITY.replace("1", "nan"), r"poses\.txt: line 1: value 1 is 'nan'"),
    ):
        path.write_text(text)
        with pytest.raises(ValueError, match=complaint):
            KittiRawDrive(folder, poses=path)


@pytest.mark.parametrize(
    ("file", "complaint"),
    [
        ("image_02/data/0000000001.png", "image_02"),
        ("velodyne_points/data/0000000001.bin", "velodyne_points"),
    ],
)
def test_a_frame_lacking_a_part_says_which_unless_gaps_are_allowed(tmp_path, file, complaint):
    folder = write_drive(tmp_path / "day" / "drive")
    (folder / file).unlink()
    with pytest.raises(ValueError, match=rf"{complaint} lacks 1 of 3 frames \(0000000001\)"):
        KittiRawDrive(folder)
    sample = KittiRawDrive(folder, allow_gaps=True)[1]
    assert (sample.image is None) == (complaint == "image_02")
    assert (sample.points is None) == (complaint == "velodyne_points")


def test_an_image_of_another_size_is_named(tmp_path):
    folder = write_drive(tmp_path / "drive", official=False)
    write_rgb(folder / "image_02" / "0000000002.png", picture(size=(5, 6)))
    with pytest.raises(ValueError, match=r"0000000002\.png: is 5x6 .* expected 12x40 like"):
        KittiRawDrive(folder)[2]


def test_a_folder_without_frames_or_without_calibration_is_named(tmp_path):
    with pytest.raises(ValueError, match=rf"{tmp_path} holds no frames, expected a raw drive"):
        KittiRawDrive(tmp_path)
    folder = write_drive(tmp_path / "drive", official=False)
    (folder / "calib_cam_to_cam.txt").unlink()
    with pytest.raises(ValueError, match=r"holds no calib_cam_to_cam\.txt"):
        KittiRawDrive(folder)


def test_drives_travel_between_processes(tmp_path):
    drive = KittiRawDrive(write_drive(tmp_path / "drive", official=False))
    assert torch.equal(pickle.loads(pickle.dumps(drive))[1].points, drive[1].points)


def test_times_are_exact_to_the_nanosecond_across_midnight(tmp_path):
    path = tmp_path / "timestamps.txt"
    path.write_text("2011-09-26 23:59:59.999999999\n2011-09-27 00:00:01.000000001\n\n")
    assert read_timestamps(path).tolist() == [0, 1.000000002]
    path.write_text("")
    assert read_timestamps(path).tolist() == []


@pytest.mark.parametrize(
    "text", ["soon", "2011-13-26 13:02:25", "2011-09-26", "2011-09-26 13:02:25.", "1 2 3"]
)
def test_a_line_that_is_no_time_is_named(tmp_path, text):
    (tmp_path / "timestamps.txt").write_text(f"2011-09-26 13:02:25\n{text}\n")
    with pytest.raises(ValueError, match=r"timestamps\.txt: line 2: .* is no time"):
        read_timestamps(tmp_path / "timestamps.txt")


def oxts(*, latitude=49.0, longitude=8.4, altitude=110.0, roll=0.0, pitch=0.0, yaw=0.0) -> str:
    values = [latitude, longitude, altitude, roll, pitch, yaw, *[0.0] * 24]
    return " ".join(map(str, values))


def write_readings(folder, *lines):
    paths = [folder / f"{number:010}.txt" for number in range(len(lines))]
    for path, line in zip(paths, lines, strict=True):
        path.write_text(line)
    mounting = folder / "calib_imu_to_velo.txt"
    mounting.write_text("R: 1 0 0 0 1 0 0 0 1\nT: -0.8 0.3 -0.8\n")
    return paths, mounting


def test_readings_of_gps_and_imu_give_metres_on_the_ground(tmp_path):
    # One degree of latitude is 111.3 km on a sphere of the equator's radius; east is yaw 0.
    north = 1.0 / (math.radians(1) * 6378137.0)
    east = north / math.cos(math.radians(49.0))
    paths, mounting = write_readings(
        tmp_path,
        oxts(),
        oxts(longitude=8.4 + 10 * east),
        oxts(latitude=49.0 + 10 * north, altitude=112.0),
    )
    poses = read_oxts_poses(paths, mounting)
    np.testing.assert_allclose(poses[0], np.eye(4), atol=1e-9)
    np.testing.assert_allclose(poses[1][:3, 3], [10, 0, 0], atol=1e-6)
    np.testing.assert_allclose(poses[2][:3, 3], [0, 10, 2], atol=1e-4)


def test_the_world_is_the_first_frames_lidar_so_its_heading_drops_out(tmp_path):
    north = 1.0 / (math.radians(1) * 6378137.0)
    facing_north = {"yaw": math.pi / 2}
    paths, mounting = write_readings(
        tmp_path,
        oxts(**facing_north),
        oxts(latitude=49.0 + 10 * north, **facing_north),
        oxts(yaw=math.pi),
    )
    poses = read_oxts_poses(paths, mounting)
    np.testing.assert_allclose(poses[1][:3, 3], [10, 0, 0], atol=1e-4)  # ahead is x
    # Turning left on the spot swings the LiDAR, at 0.8 m, -0.3 m before the IMU, around it.
    np.testing.assert_allclose(poses[2][:3, :3], [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-9)
    np.testing.assert_allclose(poses[2][:3, 3], [-0.8 + 0.3, 0.3 + 0.8, 0], atol=1e-6)


def test_convention_pitch_lowers_the_nose_and_roll_lowers_the_right_side(tmp_path):
    paths, mounting = write_readings(tmp_path, oxts(), oxts(pitch=0.1), oxts(roll=0.1))
    poses = read_oxts_poses(paths, mounting)
    assert poses[1][2, 0] == pytest.approx(-math.sin(0.1))  # z of the LiDAR's x axis
    assert poses[2][2, 1] == pytest.approx(math.sin(0.1))  # z of its y axis, which points left


def test_a_drive_calculates_its_poses_from_its_readings(tmp_path):
    folder = write_drive(tmp_path / "day" / "drive", num_frames=2)
    readings = folder / "oxts" / "data"
    readings.mkdir(parents=True)
    _, mounting = write_readings(readings, oxts(), oxts(altitude=111.0))
    mounting.rename(folder.parent / "calib_imu_to_velo.txt")
    drive = KittiRawDrive(folder, poses="oxts")
    torch.testing.assert_close(drive[1].world_from_lidar[2, 3].item(), 1.0)
    with pytest.raises(ValueError, match="no folder oxts/data"):
        KittiRawDrive(write_drive(tmp_path / "flat", official=False), poses="oxts")


def test_a_reading_with_too_few_numbers_is_named(tmp_path):
    paths, mounting = write_readings(tmp_path, "1 2 3")
    with pytest.raises(ValueError, match=r"0000000000\.txt: holds 3 numbers, expected the 30"):
        read_oxts_poses(paths, mounting)
    paths, mounting = write_readings(tmp_path, oxts(latitude=90.0))
    with pytest.raises(ValueError, match=r"0000000000\.txt: has the latitude 90\.0"):
        read_oxts_poses(paths, mounting)


def test_poses_are_read_row_by_row(tmp_path):
    (tmp_path / "poses.txt").write_text("0 -1 0 4 1 0 0 5 0 0 1 6\n")
    (pose,) = read_poses(tmp_path / "poses.txt")
    assert pose.tolist() == [[0, -1, 0, 4], [1, 0, 0, 5], [0, 0, 1, 6], [0, 0, 0, 1]]


@pytest.mark.parametrize(("second", "third"), [(3, 2), (1, 1), (0, 2)])
def test_times_that_do_not_rise_are_told_by_check_and_on_opening(tmp_path, second, third):
    folder = write_drive(tmp_path / "day" / "drive")
    (folder / "velodyne_points" / "timestamps.txt").unlink()
    path = folder / "velodyne_points" / "Timestamps.TXT"  # the case does not matter
    path.write_text("".join(f"2011-09-26 13:02:2{each}.5\n" for each in (0, second, third)))
    with pytest.warns(UserWarning, match="do not rise from frame to frame: 1 of 3"):
        KittiRawDrive(folder)
    (problem,) = check_tree(folder)
    assert problem.path == path


def camera_times(folder, seconds):
    """Give the images times [s] after 13:02:25.0; sweeps have 0.064, 0.164 and 0.264."""
    path = folder / "image_02" / "timestamps.txt"
    path.write_text("".join(f"2011-09-26 13:02:{25 + each:09.6f}\n" for each in seconds))
    return path


@pytest.mark.parametrize(
    ("seconds", "told", "remedy"),
    [
        ((0.07, 0.16, 0.27), None, None),
        ((0.07, 0.264, 0.364), "2 of 3 .* that of 0000000001 0.0996 s after", "number each image"),
        ((0.07, 0.1, 0.27), "1 of 3 images .* that of 0000000001 0.0644 s before", "number each"),
        ((3.06, 3.16, 3.26), r"3 of 3 .* 3 s after", "correct the times if two clocks differ"),
        ((0.06, 0.16), "holds 2 times, expected one for each of the 3 frames", "extract"),
        ((0.06, 0.16, 0.26, 0.36), None, None),  # a time for each number, also for lost frames
    ],
)
def test_images_taken_apart_from_their_sweeps_are_told_by_check_and_on_opening(
    tmp_path, recwarn, seconds, told, remedy
):
    folder = write_drive(tmp_path / "day" / "drive")
    path = camera_times(folder, seconds)
    KittiRawDrive(folder)
    warned = [str(each.message) for each in recwarn]
    assert warned == [str(problem) for problem in check_tree(folder)]
    if told is None:
        assert warned == []
    else:
        (line,) = warned
        assert line.startswith(f"{path}: ")
        assert re.search(told, line)
        assert remedy in line


def test_an_empty_line_is_the_time_of_a_lost_sweep_and_keeps_its_number(tmp_path, recwarn):
    folder = write_drive(tmp_path / "day" / "drive")
    path = folder / "velodyne_points" / "timestamps.txt"
    first, _, third = path.read_text().splitlines()
    path.write_text(f"{first}\n\n{third}\n")
    (folder / "velodyne_points" / "data" / "0000000001.bin").unlink()
    told = r"timestamps\.txt: has no time of 1 of 3 frames: the line of 0000000001 is empty"
    with pytest.raises(ValueError, match=told):
        KittiRawDrive(folder, allow_gaps=True)
    camera_times(folder, (0.07, 0.17, 0.27))
    drive = KittiRawDrive(folder, allow_gaps=True)
    assert [sample.timestamp_s for sample in drive] == pytest.approx([0, 0.1056, 0.2], abs=1e-4)
    (folder / "image_02" / "data" / "0000000001.png").unlink()
    drive = KittiRawDrive(folder)
    assert [sample.timestamp_s for sample in drive] == pytest.approx([0, 0.2])
    assert not recwarn


@pytest.mark.parametrize("ending", ["", "\n", "\n\n\n"])
def test_empty_lines_at_the_end_are_no_times_unless_the_last_sweep_was_lost(tmp_path, ending):
    folder = write_drive(tmp_path / "day" / "drive")
    path = folder / "velodyne_points" / "timestamps.txt"
    whole = path.read_text().rstrip()
    path.write_text(whole + ending)
    assert [sample.timestamp_s for sample in KittiRawDrive(folder)] == pytest.approx([0, 0.1, 0.2])
    path.write_text("".join(f"{line}\n" for line in whole.split("\n")[:2]) + "\n" + ending)
    (folder / "velodyne_points" / "data" / "0000000002.bin").unlink()
    camera_times(folder, (0.07, 0.17, 0.27))
    drive = KittiRawDrive(folder, allow_gaps=True)
    assert [sample.timestamp_s for sample in drive] == pytest.approx([0, 0.1, 0.2056], abs=1e-4)


def test_times_of_frames_that_lack_an_image_are_not_compared(tmp_path, recwarn):
    folder = write_drive(tmp_path / "day" / "drive")
    (folder / "image_02" / "data" / "0000000001.png").unlink()
    camera_times(folder, (0.07, 0.9, 0.27))
    KittiRawDrive(folder, allow_gaps=True)
    assert not recwarn


def test_a_drives_own_calibration_that_is_not_read_is_told_on_opening(tmp_path):
    folder = write_drive(tmp_path / "day" / "drive")
    shutil.copy(tmp_path / "day" / "calib_velo_to_cam.txt", folder)
    with pytest.warns(UserWarning, match=r"calib_velo_to_cam.txt: is not read: the drive's folder"):
        KittiRawDrive(folder)

import re
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.data.formats.image_header import read_image_size
from sightline.data.formats.kitti_calibration import (
    CalibrationMatrices,
    check_intrinsics,
    check_matrices,
    object_calibration_text,
    read_intrinsics,
    read_object_matrices,
    read_object_pose,
    read_raw_matrices,
    read_rectified_intrinsics,
)
from sightline.data.formats.kitti_files import (
    read_object_calibration,
    read_raw_calibration,
    write_object_calibration,
    write_raw_calibration,
)
from sightline.files.problem import FileError
from sightline.geometry.calibration import Calibration
from sightline.geometry.road_height import LidarPose
from sightline.geometry.tilt import Tilt
from tests.data.trees import calibration, intrinsics_text

ENTRIES = {
    "P2": "7.0 0 6.0 45.5 0 7.0 1.8 -0.3 0 0 1 4.9e-3",
    "R0_rect": "0 -1 0 1 0 0 0 0 1",
    "Tr_velo_to_cam": "0 -1 0 0.1 0 0 -1 0.2 1 0 0 0.3",
}
SIZE = (375, 1242)
PATH = Path("000000.txt")


def write(path: Path, **changes: str | None) -> Path:
    entries = {**ENTRIES, **changes}
    lines = [f"{name}: {value}\n" for name, value in entries.items() if value is not None]
    path.write_text("".join(lines))
    return path


def test_the_camera_frame_is_the_rectified_one_and_p2_is_taken_as_it_is(tmp_path):
    read = read_object_matrices(write(tmp_path / "0.txt"))
    assert read.image_from_camera[0].tolist() == [7.0, 0, 6.0, 45.5]
    # R0_rect turns x to y: the mounting's row 0 becomes row 1, its row 1 the negative row 0.
    assert read.camera_from_lidar.tolist() == [
        [0, 0, 1, -0.2],
        [0, -1, 0, 0.1],
        [1, 0, 0, 0.3],
        [0, 0, 0, 1],
    ]


@pytest.mark.parametrize("name", ["P2", "R0_rect", "Tr_velo_to_cam"])
def test_a_missing_matrix_is_named_with_file_and_size(tmp_path, name):
    path = write(tmp_path / "0.txt", **{name: None})
    with pytest.raises(ValueError, match=rf"0\.txt: lacks {name}, expected .* (12|9) numbers"):
        read_object_matrices(path)


@pytest.mark.parametrize("name", ["P2", "R0_rect", "Tr_velo_to_cam"])
@pytest.mark.parametrize("change", ["", "1", " 0.0", "x"])
def test_a_wrong_number_of_values_is_named(tmp_path, name, change):
    value = f"{ENTRIES[name]} {change}" if change else ENTRIES[name].rsplit(" ", 1)[0]
    with pytest.raises(ValueError, match=rf"0\.txt: {name} holds \d+ values, expected (12|9)"):
        read_object_matrices(write(tmp_path / "0.txt", **{name: value}))


@pytest.mark.parametrize("word", ["x", "nan", "inf", "1e400", "-1e30", "1_0", "٣", "0x1p3", "--1"])
def test_a_value_that_is_no_finite_plausible_number_is_named(tmp_path, word):
    path = write(tmp_path / "0.txt", P2=ENTRIES["P2"].replace("45.5", word))
    with pytest.raises(ValueError, match=r"0\.txt: P2: value 4 is .* expected a finite number"):
        read_object_matrices(path)


@pytest.mark.parametrize(
    ("name", "value", "complaint"),
    [
        ("P2", "0 0 0 0 0 0 0 0 0 0 0 0", "P2 is singular"),
        ("P2", "7 0 6 0 7 0 6 0 0 0 1 0", "P2 is singular"),
        ("P2", "7 0 6 0 0 7 1.8 0 0 0 2 0", "P2 has the third row .* expected 0 0 1"),
        ("R0_rect", "0 0 0 0 0 0 0 0 0", "R0_rect holds no rotation"),
        ("R0_rect", "2 0 0 0 2 0 0 0 2", "R0_rect holds no rotation"),
        ("R0_rect", "-1 0 0 0 1 0 0 0 1", "R0_rect holds no rotation"),
        ("Tr_velo_to_cam", "1 0 0 0 1 0 0 0 0 0 1 0", "Tr_velo_to_cam holds no rotation"),
        ("Tr_velo_to_cam", "0 0 0 0 0 0 0 0 0 0 0 0", "Tr_velo_to_cam holds no rotation"),
    ],
)
def test_singular_matrices_and_false_rotations_are_named(tmp_path, name, value, complaint):
    with pytest.raises(ValueError, match=rf"0\.txt: {complaint}"):
        read_object_matrices(write(tmp_path / "0.txt", **{name: value}))


def test_a_name_given_twice_and_a_line_without_a_colon_are_named_with_their_line(tmp_path):
    path = write(tmp_path / "0.txt")
    path.write_text(path.read_text() + "\nP2: 1\n")
    with pytest.raises(ValueError, match=r"0\.txt: line 5: 'P2' stands there twice"):
        read_object_matrices(path)
    path.write_text("P2 7 0 6\n")
    with pytest.raises(ValueError, match=r"0\.txt: line 1: 'P2 7 0 6' has no colon"):
        read_object_matrices(path)


def test_the_other_cameras_and_the_imu_may_be_there_or_not(tmp_path):
    plain = read_object_matrices(write(tmp_path / "0.txt"))
    more = write(tmp_path / "1.txt", P0="not looked at", Tr_imu_to_velo="")
    assert np.array_equal(read_object_matrices(more).image_from_camera, plain.image_from_camera)


def test_files_in_the_form_of_the_tracking_and_odometry_benchmarks_are_read(tmp_path):
    plain = read_object_matrices(write(tmp_path / "0.txt"))
    tracking = tmp_path / "1.txt"
    tracking.write_text(
        f"P2: {ENTRIES['P2']}\nR_rect\t{ENTRIES['R0_rect']}\n"
        f"Tr_velo_cam {ENTRIES['Tr_velo_to_cam']}\nTr_imu_velo 1 0 0 0 0 1 0 0 0 0 1 0\n"
    )
    assert np.array_equal(read_object_matrices(tracking).stacked, plain.stacked)
    assert read_object_pose(tracking) is None
    numbers = " ".join(map(str, plain.camera_from_lidar[:3].flat))
    odometry = tmp_path / "2.txt"
    odometry.write_text(f"P2: {ENTRIES['P2']}\nTr: {numbers}\n")
    assert np.array_equal(read_object_matrices(odometry).stacked, plain.stacked)


@pytest.mark.parametrize("line", ["R_rect: 1 2 3", "R_rect 1 2 3", "R_rect\t1 2 3"])
def test_names_of_the_tracking_benchmark_beside_those_of_the_object_benchmark_are_ignored(
    tmp_path, line
):
    plain = read_object_matrices(write(tmp_path / "0.txt"))
    path = write(tmp_path / "1.txt")
    path.write_text(f"{line}\n{path.read_text()}")
    assert np.array_equal(read_object_matrices(path).stacked, plain.stacked)


def test_names_of_waymo_s_data_in_kitti_s_form_are_told(tmp_path):
    changes = {"Tr_velo_to_cam": None, "Tr_velo_to_cam_0": ENTRIES["Tr_velo_to_cam"]}
    with pytest.raises(ValueError, match="Waymo's data in KITTI's form, where P2 is ano") as caught:
        read_object_matrices(write(tmp_path / "0.txt", **changes))
    assert "its pictures as image_2 and its labels as label_2 (camera 0, image_0" in str(caught)


def test_lines_for_data_without_a_lidar_are_told_and_fit(tmp_path):
    path = write(tmp_path / "0.txt", R0_rect=None, Tr_velo_to_cam=None)
    with pytest.raises(
        ValueError, match="lacks R0_rect and Tr_velo_to_cam, expected lines"
    ) as caught:
        read_object_matrices(path)
    lines = re.findall("'([^']*:[^']*)'", str(caught.value))
    with path.open("a") as file:
        file.writelines(f"{line}\n".replace("H", "-0.08") for line in lines)
    below = read_object_matrices(path).camera_from_lidar @ (10, 0, -1.73, 1)
    assert below.tolist() == pytest.approx([0, 1.65, 10, 1])


def test_bytes_that_are_no_text_are_named(tmp_path):
    (tmp_path / "0.txt").write_bytes(b"P2: \xff")
    with pytest.raises(ValueError, match=r"0\.txt: is no text: byte 4 is not UTF-8"):
        read_object_matrices(tmp_path / "0.txt")


angles = st.floats(-3, 3)
numbers = st.floats(-1e3, 1e3)


@given(turns=st.tuples(angles, angles, angles), values=st.lists(numbers, min_size=9, max_size=9))
def test_both_formats_give_a_written_calibration_back_bit_by_bit(tmp_path_factory, turns, values):
    folder = tmp_path_factory.mktemp("calibration")
    focal, image = values[0] + 2e3, torch.zeros(3, 4, dtype=torch.float64)
    image[:, 3] = torch.tensor(values[3:6], dtype=torch.float64)
    image[:, :3] = torch.tensor([[focal, 0, values[1]], [0, focal, values[2]], [0, 0, 1]])
    skew = torch.tensor(
        [[0, -turns[2], turns[1]], [turns[2], 0, -turns[0]], [-turns[1], turns[0], 0]]
    )
    camera_from_lidar = torch.eye(4, dtype=torch.float64)
    camera_from_lidar[:3, :3] = torch.matrix_exp(skew.double())
    camera_from_lidar[:3, 3] = torch.tensor(values[6:], dtype=torch.float64)
    written = Calibration(image_from_camera=image, camera_from_lidar=camera_from_lidar)
    write_object_calibration(folder / "0.txt", written)
    write_raw_calibration(folder, written)
    for read in (read_object_calibration(folder / "0.txt"), read_raw_calibration(folder)):
        assert torch.equal(read.image_from_camera, written.image_from_camera)
        assert torch.equal(read.camera_from_lidar, written.camera_from_lidar)


def test_the_written_object_file_has_all_lines_in_the_order_that_other_tools_expect(tmp_path):
    write_object_calibration(tmp_path / "0.txt", calibration())
    names = [line.split(":")[0] for line in (tmp_path / "0.txt").read_text().splitlines()]
    assert names == ["P0", "P1", "P2", "P3", "R0_rect", "Tr_velo_to_cam", "Tr_imu_to_velo"]


def test_a_batch_of_calibrations_fits_no_file(tmp_path):
    one = calibration()
    batch = Calibration(
        image_from_camera=one.image_from_camera.expand(2, 3, 4),
        camera_from_lidar=one.camera_from_lidar.expand(2, 4, 4),
    )
    with pytest.raises(ValueError, match=r"holds one calibration, got a batch of shape \(2,\)"):
        write_object_calibration(tmp_path / "0.txt", batch)


def test_raw_files_are_named_by_the_one_that_is_at_fault(tmp_path):
    write_raw_calibration(tmp_path, calibration())
    lidar = tmp_path / "calib_velo_to_cam.txt"
    lidar.write_text(lidar.read_text().replace("R:", "S:"))
    with pytest.raises(ValueError, match=r"calib_velo_to_cam\.txt: lacks R"):
        read_raw_matrices(tmp_path)
    (tmp_path / "calib_cam_to_cam.txt").write_text("calib_time: 09-Jan-2012 13:57:47\n")
    with pytest.raises(ValueError, match=r"calib_cam_to_cam\.txt: lacks P_rect_02"):
        read_raw_matrices(tmp_path)


def test_intrinsics_of_the_depth_benchmark_are_nine_numbers(tmp_path):
    (tmp_path / "k.txt").write_text(intrinsics_text() + "\n")
    assert read_intrinsics(tmp_path / "k.txt")[0].tolist() == [20.0, 0.0, 19.5]
    for text, complaint in (("1 2 3", "holds 3 numbers"), ("0 " * 9, "the matrix is singular")):
        (tmp_path / "k.txt").write_text(text)
        with pytest.raises(ValueError, match=rf"k\.txt: {complaint}"):
            read_intrinsics(tmp_path / "k.txt")


def test_intrinsics_of_a_raw_recording_are_those_of_the_camera_asked_for(tmp_path):
    path = tmp_path / "calib_cam_to_cam.txt"
    path.write_text("P_rect_02: 7 0 6 1 0 7 2 1 0 0 1 1\nP_rect_03: 8 0 6 1 0 8 2 1 0 0 1 1\n")
    assert read_rectified_intrinsics(path, 3).tolist() == [[8, 0, 6], [0, 8, 2], [0, 0, 1]]
    with pytest.raises(ValueError, match="lacks P_rect_01"):
        read_rectified_intrinsics(path, 1)


def matrices(
    *,
    focal_px=(720.0, 720.0),
    center_px=(610.0, 173.0),
    baseline_m=0.06,
    lidar_m=0.3,
    inverted=False,
):
    image_from_camera = np.zeros((3, 4))
    image_from_camera[[0, 1], [0, 1]] = focal_px
    image_from_camera[:2, 2] = center_px
    image_from_camera[2, 2] = 1
    image_from_camera[:, 3] = image_from_camera[:, 0] * baseline_m
    camera_from_lidar = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, lidar_m], [0, 0, 0, 1.0]])
    if inverted:
        camera_from_lidar = np.linalg.inv(camera_from_lidar)
    return CalibrationMatrices(
        image_from_camera=image_from_camera, camera_from_lidar=camera_from_lidar
    )


@pytest.mark.parametrize(
    ("change", "doubt"),
    [
        ({"focal_px": (-720.0, 720.0)}, "has focal lengths of -720 and 720 px, expected both abo"),
        ({"focal_px": (720.0, -1.0)}, "has focal lengths of 720 and -1 px, expected both above 0"),
        ({"focal_px": (1e6, 1e6)}, "has focal lengths of 1e+06 and 1e+06 px, which do not fit"),
        ({"focal_px": (1.0, 1.0)}, "has focal lengths of 1 and 1 px, which do not fit an image"),
        ({"center_px": (610.0, 1e5)}, "has its principal point at (610, 100000), far from an ima"),
        (
            {"focal_px": (720.0, 1440.0)},
            "has focal lengths of 720 and 1440 px, one 2 times the o",
        ),
        ({"center_px": (330.0, 173.0)}, "has its principal point at (330, 173), away from the cen"),
        ({"center_px": (610.0, 310.0)}, "has its principal point at (610, 310), away from the cen"),
        ({"baseline_m": -1e4}, "has a camera 1e+04 m from the rectified origin, expected"),
        (
            {"lidar_m": 1e8},
            "holds a transform from LiDAR to camera that puts the LiDAR 1e+08 m from",
        ),
        ({"inverted": True}, "holds a transform from LiDAR to camera that is probably inverted"),
    ],
)
def test_sensors_that_cannot_sit_on_one_vehicle_are_doubted_in_one_line(change, doubt):
    (problem,) = check_matrices(matrices(**change), SIZE, PATH)
    assert problem.problem.startswith(doubt)
    assert problem.path == PATH


def test_a_sound_calibration_raises_no_doubt_with_and_without_an_image():
    assert check_matrices(matrices(), SIZE, PATH) == []
    assert check_matrices(matrices(), None, PATH) == []
    assert check_intrinsics(matrices().image_from_camera[:, :3], SIZE, PATH) == []


def test_the_calibrations_of_kitti_raise_no_doubt(kitti_root):
    paths = sorted(kitti_root.glob("training/calib/*.txt"))
    assert len(paths) == 90
    for path in paths:
        size = read_image_size(kitti_root / "training" / "image_2" / f"{path.stem}.png")
        assert check_matrices(read_object_matrices(path), size, path) == []


@pytest.mark.parametrize(("row", "column"), [(0, 1), (1, 0)])
def test_skewed_pixel_axes_are_doubted(row, column):
    skewed = matrices()
    skewed.image_from_camera[row, column] = 30.0
    (problem,) = check_matrices(skewed, SIZE, PATH)
    assert "has skewed pixel axes" in problem.problem
    skewed.image_from_camera[row, column] = 1.0
    assert check_matrices(skewed, SIZE, PATH) == []


def test_the_camera_matrix_of_another_resolution_is_doubted():
    (problem,) = check_matrices(matrices(), (188, 621), PATH)
    assert problem.problem.startswith("holds a camera matrix that has its principal point in the")
    assert check_matrices(matrices(), (352, 1216), PATH) == []  # a crop


TILTED = LidarPose(height_m=1.9, tilt=Tilt(roll_deg=-1.5, pitch_deg=2.5))
MATRICES = CalibrationMatrices(
    image_from_camera=np.array(
        [[700.0, 0.0, 600.0, 0.0], [0.0, 700.0, 180.0, 0.0], [0.0, 0.0, 1.0, 0.0]]
    ),
    camera_from_lidar=np.array(
        [[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
    ),
)


@pytest.mark.parametrize("pose", [None, LidarPose(height_m=2.1, tilt=None), TILTED])
def test_the_mount_over_the_road_is_read_as_it_was_written(tmp_path, pose):
    path = tmp_path / "calib.txt"
    path.write_text(object_calibration_text(MATRICES, pose))
    assert read_object_pose(path) == pose
    read = read_object_matrices(path)
    np.testing.assert_array_equal(read.camera_from_lidar, MATRICES.camera_from_lidar)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("lidar_height_m: 1.9", "lidar_height_m: 19", "lidar_height_m is 19 m, expected -0.3 to"),
        ("lidar_height_m: 1.9", "lidar_height_m: high", "lidar_height_m"),
        ("lidar_height_m: 1.9", "height: 1.9", "lacks lidar_height_m"),
        ("lidar_tilt_deg: -1.5", "lidar_tilt_deg: -70", "lidar_tilt_deg exceeds 45 degrees"),
        ("lidar_tilt_deg: -1.5", "lidar_tilt_deg: 1 2", "lidar_tilt_deg holds 3 values"),
    ],
)
def test_a_mount_that_is_not_plausible_is_named(tmp_path, old, new, message):
    path = tmp_path / "calib.txt"
    text = object_calibration_text(MATRICES, TILTED)
    text = text.replace("1.8999999999999999e+00", "1.9").replace("-1.5000000000000000e+00", "-1.5")
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(FileError, match=message):
        read_object_pose(path)

"""The calibration file of a recording: what is refused, doubted and written back."""

import math

import numpy as np
import pytest
import yaml

from sightline.data.check import check_tree
from sightline.data.formats.kitti_calibration import CalibrationMatrices
from sightline.data.formats.recording_calibration import (
    RecordingCalibration,
    read_recording_calibration,
    recording_calibration_text,
)
from sightline.data.open import open_dataset
from sightline.files.problem import FileError
from sightline.geometry.tilt import Tilt
from tests.data.recordings import (
    CAMERA_FROM_LIDAR,
    CAMERA_MATRIX,
    calibration_entries,
    write_calibration,
    write_recording,
)


@pytest.mark.parametrize("entry", ["distortion_model: plumb_bob", "camera_name: a", "P2: [1]"])
def test_an_unknown_entry_of_a_recordings_own_calibration_is_named(tmp_path, entry):
    path = tmp_path / "calibration.yaml"
    path.write_text(f"camera_matrix: [[700]]\ncamera_from_lidar: [[0]]\n{entry}\n")
    with pytest.raises(FileError, match=f"has the unknown entry '{entry.partition(':')[0]}'"):
        read_recording_calibration(path)
    path.write_text(f"camera_from_lidar: [[0]\n{entry}\n")
    with pytest.raises(FileError, match="is neither YAML nor JSON: line 2"):
        read_recording_calibration(path)


@pytest.mark.parametrize(
    ("text", "program"),
    [
        ("%YAML:1.0\n---\ncamera_matrix: !!opencv-matrix\n   rows: 3\n", "OpenCV"),
        ("P0: 7.2e+02 0.0 6.0e+02 0.0 0.0 7.2e+02 1.7e+02 0.0 0.0 0.0 1.0 0.0\nP1: 1 2 3", "KITTI"),
        ("calib_time: 15-Mar-2012\nR: 7e-3 1e-2 1.5\nT: -4e-3 7e-2 -0.2\n", "KITTI"),
        ('{"K": {"type_id": "opencv-matrix", "rows": 3}}', "OpenCV"),
        ("cam0:\n  T_cam_imu: [[1]]\n", "Kalibr"),
        ("image_width: 640\ncamera_name: left\ncamera_matrix: {rows: 3}\n", "ROS"),
    ],
)
def test_calibrations_of_other_programs_are_named(tmp_path, text, program):
    (tmp_path / "calibration.yaml").write_text(text)
    with pytest.raises(FileError, match=f"is a calibration in the format of {program}; write its"):
        read_recording_calibration(tmp_path / "calibration.yaml")


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            {"camera_matrix": [[1, 0], [0, 1]]},
            "camera_matrix is invalid, expected a matrix of 3x3 or 3x4 numbers",
        ),
        ({"camera_matrix": CAMERA_MATRIX.T.tolist()}, "expected 0 0 1: it is probably transposed"),
        ({"camera_matrix": (-CAMERA_MATRIX).tolist()}, "third row"),
        ({"camera_from_lidar": CAMERA_FROM_LIDAR.T.tolist()}, "0 0 0 1: it is probably transposed"),
        ({"camera_from_lidar": [[float("nan")] * 4] * 3}, "holds NaN, infinite or absurdly large"),
        ({"camera_from_lidar": [[0] * 4] * 3}, "holds no rotation"),
        (
            {"max_intensity": "255"},
            "max_intensity holds '255', expected numbers, such as -0.5, with",
        ),
        ({"max_intensity": -1}, "max_intensity is -1, expected a number above 0, below 1e9"),
        ({"lidar_height_m": "1.7"}, "lidar_height_m holds '1.7', expected numbers, such as"),
        ({"lidar_height_m": 173}, "lidar_height_m is 173, expected the LiDAR's height above"),
        ({"lidar_height_m": 10**400}, "lidar_height_m is 1000"),
        ({"lidar_tilt_deg": 3}, "lidar_tilt_deg is 3, expected {roll: .., pitch: ..}"),
        ({"lidar_tilt_deg": {"roll": 3}}, "expected {roll: .., pitch: ..}"),
        ({"lidar_tilt_deg": {"roll": 3, "pitch": 90}}, "each from -45 to 45"),
        ({"lidar_tilt_deg": {"roll": 3, "pitch": math.nan}}, "each from -45 to 45"),
        (
            {"lidar_tilt_deg": {"roll": True, "pitch": 0}},
            "lidar_tilt_deg holds True, expected numbers",
        ),
        ({"camera_matrix": [[10**400] * 3] * 3}, "NaN, infinite or absurdly large values"),
        ({"camera_matrix": [["700", 0, 5]] * 3}, "camera_matrix holds '700', expected numbers"),
        ({"camera_matrix": [[True, 0, 5]] * 3}, "camera_matrix holds True, expected numbers"),
        ({"camera_matrix": [[None, 0, 5]] * 3}, "camera_matrix holds None, expected numbers"),
        (
            {"camera_matrix": [[0] * 9]},
            "camera_matrix is invalid, expected a matrix of 3x3 or 3x4 numbers",
        ),
        ({"camera_matrix": np.zeros((3, 3)).tolist()}, "only zeros: the camera is not"),
        ({"image_size": [375, 1242]}, "image_size is invalid, expected {width: .., height: ..}"),
        ({"image_size": {"width": 0, "height": 1}}, "expected width and height in whole pixels"),
        (
            {"image_size": {"width": True, "height": True}},
            "expected width and height in whole pixels",
        ),
        ({"lens": [0.1]}, "lens is invalid, expected"),
        ({"camera_matrix": [[7e-1, 0, 5], [0, 7e-1, 5], [0, 0, 1]]}, "are probably in millimetres"),
        ({"camera_matrix": [[7e3, 0, 5], [0, 7, 5], [0, 0, 1]]}, "expected both alike"),
        ({"image_size": {"width": 60000, "height": 60000}}, "image_size is 60000x60000, more than"),
        (
            {
                "image_size": {"width": 1242, "height": 375},
                "lens": {"coefficients": [-5, 0, 0, 0], "undistort": True},
            },
            "lens folds the picture of 375x1242 over itself",
        ),
        ({"lens": {"coefficients": "1234"}}, "lens has invalid coefficients, expected a list"),
        ({"lens": {"coefficients": [10**400] * 4}}, "expected 4 or 5 finite numbers"),
        ({"lens": {"coefficients": ["0.1"] * 4}}, "lens: coefficients holds '0.1', expected"),
        (
            {"lens": {"coefficients": [0.1]}},
            "expected 4 or 5 finite numbers for the model plumb_bob",
        ),
        (
            {"lens": {"coefficients": [0.1] * 4, "model": "pinhole"}},
            "lens has the unknown model 'pinhole', expected one of",
        ),
        ({"focal": 3}, "has the unknown entry 'focal'"),
    ],
)
def test_a_calibration_that_makes_no_sense_is_refused_by_file_and_entry(tmp_path, changes, said):
    write_recording(tmp_path, ("a",))
    write_calibration(tmp_path, **changes)
    with pytest.raises(FileError) as caught:
        read_recording_calibration(tmp_path / "calibration.yaml")
    assert said in caught.value.problem.problem
    (problem,) = check_tree(tmp_path)
    assert said in problem.problem


@pytest.mark.parametrize("text", ["", "[1, 2]", "{", "a: [b", "\x00", "- !!python/object:x {}"])
def test_what_is_no_calibration_file_is_refused(tmp_path, text):
    path = tmp_path / "calibration.yaml"
    path.write_text(text)
    with pytest.raises(FileError, match=r"docs/recordings.md|holds a NUL byte"):
        read_recording_calibration(path)


def test_a_calibration_is_written_so_that_it_is_read_back_bit_by_bit(tmp_path):
    path = tmp_path / "calibration.yaml"
    lens = {"model": "equidistant", "coefficients": [0.1, 1e-7, 0, 0.3], "undistort": True}
    changes = {"lens": lens, "image_size": {"width": 1242, "height": 375}, "lidar_height_m": 2.1}
    changes["lidar_tilt_deg"] = {"roll": 0.5, "pitch": -11.25}
    path.write_text(yaml.safe_dump(calibration_entries(**changes)))
    read = read_recording_calibration(path)
    path.write_text(recording_calibration_text(read))
    again = read_recording_calibration(path)
    for name in ("image_from_camera", "camera_from_lidar"):
        ours, theirs = getattr(read.matrices, name), getattr(again.matrices, name)
        np.testing.assert_array_equal(ours, theirs)
    assert (again.image_size, again.max_intensity) == ((375, 1242), 255)
    assert again.lidar_height_m == 2.1
    assert again.lidar_tilt == Tilt(roll_deg=0.5, pitch_deg=-11.25)
    assert (again.lens.model, again.lens.coefficients) == ("equidistant", (0.1, 1e-7, 0.0, 0.3))


def test_a_calibration_that_was_corrected_is_read_again(tmp_path):
    write_recording(tmp_path, ("a",))
    assert open_dataset(tmp_path)[0].calibration.camera_from_lidar[0, 3] != 0.5
    moved = CAMERA_FROM_LIDAR.copy()
    moved[0, 3] = 0.5
    write_calibration(tmp_path, camera_from_lidar=moved.tolist())
    assert open_dataset(tmp_path)[0].calibration.camera_from_lidar[0, 3] == 0.5


def test_a_recording_without_a_calibration_is_known_as_one(tmp_path):
    write_recording(tmp_path, ("a",))
    (tmp_path / "calibration.yaml").unlink()
    with pytest.raises(ValueError, match=r"without a calibration; write calibration.yaml beside"):
        open_dataset(tmp_path)
    (problem,) = check_tree(tmp_path)
    assert problem.problem == "holds images or points without a calibration"


def test_a_principal_point_of_another_image_is_told_on_opening(tmp_path):
    write_recording(tmp_path, ("1", "2"))
    write_calibration(tmp_path, camera_matrix=[[720, 0, 200], [0, 720, 180], [0, 0, 1]])
    with pytest.warns(UserWarning, match="has its principal point at"):
        open_dataset(tmp_path)


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_camera_matrix_of_another_resolution_is_told_once(tmp_path, factor):
    camera = np.diag([factor, factor, 1]) @ CAMERA_MATRIX
    write_recording(tmp_path, camera_matrix=camera.tolist())
    with pytest.warns(UserWarning, match="it is for another resolution"):
        open_dataset(tmp_path)
    (problem,) = check_tree(tmp_path)
    assert problem.path == tmp_path / "calibration.yaml"
    assert "but images are 375x1242" in problem.problem


@pytest.mark.parametrize("focal_px", [0.0, -700.0, 1e308, math.nan, math.inf])
def test_a_calibration_that_no_reader_takes_is_not_written(focal_px):
    camera = np.pad(CAMERA_MATRIX.copy(), ((0, 0), (0, 1)))
    camera[0, 0] = camera[1, 1] = focal_px
    matrices = CalibrationMatrices(image_from_camera=camera, camera_from_lidar=CAMERA_FROM_LIDAR)
    with pytest.raises(ValueError, match=r"camera_matrix (holds NaN|has focal lengths)"):
        recording_calibration_text(RecordingCalibration(matrices=matrices))

import numpy as np
import pytest
import torch

from sightline.geometry.calibration import Calibration, centred_image_size

CAMERA = [[1100.0, 0, 959.5], [0, 1101.0, 599.5], [0, 0, 1]]
RIGID = [[0.0, -1, 0, 0.1], [0, 0, -1, -0.4], [1, 0, 0, -0.3], [0, 0, 0, 1]]


@pytest.mark.parametrize(
    "as_given",
    [
        lambda rows: rows,
        lambda rows: tuple(map(tuple, rows)),
        np.float32,
        np.array,
        lambda rows: np.array(rows, dtype=">f8"),
        torch.tensor,
        lambda rows: torch.tensor(rows, dtype=torch.float64, requires_grad=True),
    ],
)
@pytest.mark.parametrize("rows", [3, 4])
def test_matrices_of_any_type_make_one_calibration(as_given, rows):
    made = Calibration.from_matrices(as_given(CAMERA), as_given(RIGID[:rows]))
    expected = torch.tensor(CAMERA, dtype=torch.float64)
    assert torch.equal(made.image_from_camera[:, :3], expected)
    assert not made.image_from_camera[:, 3].any()
    torch.testing.assert_close(
        made.camera_from_lidar, torch.tensor(RIGID, dtype=torch.float64), rtol=0, atol=1e-7
    )
    assert centred_image_size(made.image_from_camera) == (1200, 1920)


def test_a_projection_keeps_its_last_column():
    projection = np.array([[700, 0, 600, 40], [0, 700, 170, 0.2], [0, 0, 1, 0.003]])
    made = Calibration.from_matrices(projection, RIGID)
    np.testing.assert_array_equal(made.image_from_camera.numpy(), projection)


def with_(rows, row, column, value):
    changed = np.array(rows, dtype=np.float64)
    changed[row, column] = value
    return changed


@pytest.mark.parametrize(
    ("camera", "rigid", "message"),
    [
        (CAMERA[:2], RIGID, "camera_matrix is 2x3, expected a matrix of 3x3 or 3x4 numbers"),
        ([[1.0, 0.0], [2.0]], RIGID, "camera_matrix is .*, expected an array"),
        (np.array(5.0), RIGID, "camera_matrix is .*, expected a matrix of 3x3"),
        (np.ravel(CAMERA), RIGID, "camera_matrix is .*; give .reshape.3, 3."),
        (RIGID, CAMERA, "camera_matrix is 4x4, .* swap the arguments"),
        (np.array(CAMERA, complex), RIGID, "camera_matrix is array.*, expected numbers; give"),
        (np.ma.masked_equal(CAMERA, 1), RIGID, "camera_matrix has . of 9 values masked"),
        (CAMERA, np.eye(3), "camera_from_lidar is 3x3, expected a matrix of 4x4 or 3x4"),
        (with_(CAMERA, 0, 0, np.nan), RIGID, "camera_matrix holds NaN or infinite values"),
        (CAMERA, with_(RIGID, 1, 3, np.inf), "camera_from_lidar holds NaN or infinite values"),
        (np.transpose(CAMERA), RIGID, "third row .* expected 0 0 1: it is probably transposed"),
        (with_(CAMERA, 2, 2, 1.0005), RIGID, "third row .*1.0005.*, expected 0 0 1"),
        (with_(CAMERA, 0, 0, -5), RIGID, "focal lengths of -5 and 1101 px, expected both above 0"),
        (np.diag([0.6, 0.9, 1]), RIGID, "of 0.6 and 0.9 px, .* shares of the image; give pixels"),
        (with_(CAMERA, 0, 0, 90), RIGID, "of 90 and 1101 px, expected both alike and at least 1"),
        (CAMERA, np.transpose(RIGID), "camera_from_lidar is transposed"),
        (CAMERA, with_(RIGID, 0, 1, 1), "holds? .*rotation"),
        (CAMERA, with_(RIGID, 3, 3, 2), "is not rigid"),
    ],
)
def test_what_is_no_calibration_is_refused_with_the_matrix_name(camera, rigid, message):
    with pytest.raises(ValueError, match=message):
        Calibration.from_matrices(camera, rigid)


@pytest.mark.parametrize("factor", [0.5, 2])
def test_unlike_focal_lengths_are_warned_of_with_their_ratio(factor):
    with pytest.warns(UserWarning, match="^camera_matrix has focal .*, one 2 times the other"):
        Calibration.from_matrices(with_(CAMERA, 1, 1, 1100 * factor), RIGID)
    Calibration.from_matrices(with_(CAMERA, 1, 1, 1100 * 1.2), RIGID)  # a resized image's


def test_lens_distortion_is_refused_with_the_way_to_straighten_it():
    Calibration.from_matrices(CAMERA, RIGID, distortion=np.zeros(5))
    for distortion in ([-0.3, 0.1, 0, 0], torch.tensor([-0.3, 0.1])):
        with pytest.raises(ValueError, match=r"distortion is -0.3, 0.1.* with sightline.undistort"):
            Calibration.from_matrices(CAMERA, RIGID, distortion=distortion)


def test_a_mount_that_cannot_be_is_warned_of_by_its_likely_cause():
    with pytest.warns(UserWarning, match="camera_from_lidar is probably inverted"):
        Calibration.from_matrices(CAMERA, np.linalg.inv(RIGID))

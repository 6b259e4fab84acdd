from pathlib import Path

import numpy as np
import pytest

from sightline.data.calibration_checks import check_intrinsics, check_matrices
from sightline.data.calibration_text import CalibrationMatrices, read_object_matrices
from sightline.data.image_header import read_image_size

SIZE = (375, 1242)
PATH = Path("000000.txt")


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
        ({"focal_px": (720.0, 1440.0)}, "has focal lengths of 720 and 1440 px, expected both alik"),
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

"""From arrays, from a folder and from a bag to depth, boxes and a picture, in ten lines each."""

import inspect

import numpy as np
import pytest

from sightline.data.formats.image_file import read_rgb
from tests.data.recordings import (
    CAMERA_FROM_LIDAR,
    CAMERA_MATRIX,
    IMAGE,
    POINTS,
    write_bag,
    write_recording,
)

MAX_LINES = 10


def from_arrays(image, points, camera_matrix, camera_from_lidar):
    import sightline

    calibration = sightline.Calibration.from_matrices(camera_matrix, camera_from_lidar)
    sample = sightline.CameraLidarSample.from_arrays(calibration, image=image, points=points)
    depth = sightline.load("depth-fast-cpu")(sample)
    found = sightline.load("detection2d-fast-cpu")(sample).detections
    page = sightline.frame_sheet(sample, depth, detections2d=found)
    sightline.write_rgb("page.png", page)
    return depth, found


def from_a_folder(folder):
    import sightline

    sample = sightline.open_dataset(folder)[0]
    depth = sightline.load("depth-fast-cpu")(sample)
    found = sightline.load("detection2d-fast-cpu")(sample).detections
    page = sightline.frame_sheet(sample, depth, detections2d=found)
    sightline.write_rgb("page.png", page)
    return depth, found


def from_a_bag(bag):
    import sightline

    print(sightline.import_recording(bag, "recording"))
    sample = sightline.open_dataset("recording")[0]
    depth = sightline.load("depth-fast-cpu")(sample)
    found = sightline.load("detection2d-fast-cpu")(sample).detections
    page = sightline.frame_sheet(sample, depth, detections2d=found)
    sightline.write_rgb("page.png", page)
    return depth, found


def given_arrays(folder):
    del folder
    return IMAGE, POINTS.astype(np.float64), CAMERA_MATRIX, CAMERA_FROM_LIDAR


def given_folder(folder):
    return (write_recording(folder / "mine", ("a",), cloud=".pcd"),)


def given_bag(folder):
    return (write_bag(folder / "drive", 1),)


@pytest.mark.parametrize(
    ("script", "given"),
    [(from_arrays, given_arrays), (from_a_folder, given_folder), (from_a_bag, given_bag)],
)
def test_ten_lines_lead_to_depth_boxes_and_a_picture(script, given, tmp_path, monkeypatch):
    body = [line for line in inspect.getsource(script).splitlines()[1:] if line.strip()]
    assert len(body) <= MAX_LINES
    monkeypatch.chdir(tmp_path)
    depth, found = script(*given(tmp_path))
    assert depth.depth_m.shape == IMAGE.shape[:2]
    assert depth.valid.float().mean() > 0.3
    assert "Car" in found.class_names
    assert read_rgb("page.png").shape[2] == 3

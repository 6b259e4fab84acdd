import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sightline.data.checks.frame_checks import examine_object_frame
from sightline.data.checks.label_fit import check_label_fit
from sightline.data.checks.recording_checks import examine_recording_frame
from sightline.data.checks.tree_checks import find_trees
from sightline.data.formats.kitti_calibration import CalibrationMatrices, read_object_matrices
from sightline.data.formats.kitti_labels import parse_objects
from sightline.data.formats.velodyne import read_sweep
from sightline.data.layouts.kitti_trees import ObjectFrame
from sightline.simulation.packaged import PACKAGED_FRAMES
from tests.data.recordings import write_recording

FRAMES = PACKAGED_FRAMES / "training"
SIZE = (375, 1242)


def doubts(
    text: str, *, points=None, focal: float = 1.0, path: Path | None = None, size=SIZE
) -> list[str]:
    path = path or FRAMES / "label_2/000000.txt"
    objects = parse_objects(text.encode(), path, with_scores=False)
    matrices = read_object_matrices(FRAMES / "calib/000000.txt")
    projection = matrices.image_from_camera.copy()
    projection[:2, :2] *= focal
    matrices = CalibrationMatrices(
        image_from_camera=projection, camera_from_lidar=matrices.camera_from_lidar
    )
    return [each.problem for each in check_label_fit(objects, matrices, size, points, path)]


@pytest.fixture
def labels() -> str:
    return (FRAMES / "label_2/000000.txt").read_text()


@pytest.fixture
def points() -> np.ndarray:
    return read_sweep(FRAMES / "velodyne/000000.bin")


def changed(text: str, column: int, change) -> str:
    rows = [line.split() for line in text.splitlines()]
    for row in rows:
        if row[0] != "DontCare":
            row[column] = str(change(row, float(row[column])))
    return "\n".join(" ".join(row) for row in rows)


def test_sound_labels_raise_no_doubt(labels, points):
    assert doubts(labels, points=points) == []
    assert doubts(labels) == []
    assert doubts(labels, size=None) == []
    assert doubts(labels, points=points[:0]) == []


def test_another_cameras_focal_length_is_doubted(labels, points):
    (doubt,) = doubts(labels, points=points, focal=0.5)
    assert "3D boxes whose projections do not fit its 2D boxes" in doubt


@pytest.mark.parametrize(
    ("column", "change"),
    [
        (12, lambda row, y: y - float(row[8]) / 2),  # the box's centre instead of its bottom's
        (11, lambda _, x: -x),
        (13, lambda _, z: -z),
    ],
)
def test_places_of_another_convention_are_doubted(labels, column, change):
    for size in (SIZE, None):  # 3D detection reads no images
        (doubt,) = doubts(changed(labels, column, change), size=size)
        assert "do not fit its 2D boxes" in doubt


def test_placeholders_for_2d_boxes_are_not_compared(labels, points):
    for column in range(4, 8):
        labels = changed(labels, column, lambda *_: -1)
    assert doubts(labels, points=points) == []


def test_cloud_of_another_frame_or_unit_is_doubted(labels, points):
    (doubt,) = doubts(labels, points=points * np.float32([3.28, 3.28, 3.28, 1]))
    assert "no point of the cloud in their 3D box" in doubt
    assert "no point of the cloud" in doubts(labels, points=points[:10])[0]


def test_an_object_with_an_inside_out_2d_box_is_not_compared(labels):
    rows = [line.split() for line in labels.splitlines() if not line.startswith("DontCare")][:3]
    for row in rows[:2]:
        row[4], row[6] = row[6], row[4]
    assert doubts("\n".join(" ".join(row) for row in rows)) == []


def test_other_remarks_do_not_hide_boxes_that_do_not_fit(tmp_path, labels):
    path = tmp_path / "labels.txt"
    text = _times(in_lidar(labels, at_centre=False), range(4, 8), 0)
    for column, change in (
        (1, lambda *_: 2),  # truncation
        (2, lambda *_: 0),
        (14, lambda _, angle: angle + 2 * np.pi * (angle < 0)),
    ):
        text = changed(text, column, change)
    path.write_text(text.replace("Car", "car"))
    frame = ObjectFrame(
        sample_id="0",
        points=FRAMES / "velodyne/000000.bin",
        calibration=FRAMES / "calib/000000.txt",
        objects=path,
    )
    write_recording(tmp_path, names=("labels",), cloud=".bin")
    recorded = replace(
        frame,
        points=tmp_path / "points/labels.bin",
        calibration=tmp_path / "calibration.yaml",
        image=tmp_path / "images/labels.jpg",
    )
    for found in (
        examine_object_frame(frame),
        examine_recording_frame(recorded, reference=recorded.image),
    ):
        told = " ".join(each.problem for each in found.all())
        assert "has placeholders such as 0 0 0 0" in told
        assert "no class of KITTI" in told
        assert "angles outside -pi to pi" in told
        assert "truncations other than" in told
        assert "no point of the cloud in their 3D box; if x, y, z are in the LiDAR's frame" in told


def test_one_object_tells_too_little(labels):
    first = labels.splitlines()[0]
    assert doubts(first, focal=0.5) == []


def test_check_tells_labels_of_another_camera_but_not_of_corrupted_trees(tmp_path):
    root = tmp_path / "KITTI"
    shutil.copytree(FRAMES, root / "training", ignore=shutil.ignore_patterns("depth"))
    for path in (root / "training/calib").iterdir():
        lines = path.read_text().splitlines()
        words = lines[2].split()
        words[1], words[6] = (str(float(words[place]) / 2) for place in (1, 6))  # focal lengths
        lines[2] = " ".join(words)
        path.write_text("\n".join(lines))

    def problems() -> list[str]:
        (tree,) = find_trees(root)
        return [each.problem for check in tree.checks for each in check.run()]

    assert ["do not fit its 2D boxes" in each for each in problems()] == [True, True]
    (root / "training/corruption").mkdir()
    assert problems() == []


def in_lidar(text: str, *, at_centre: bool) -> str:
    """Labels with x, y, z and the yaw of the LiDAR's frame."""
    lidar_from_camera = np.linalg.inv(
        read_object_matrices(FRAMES / "calib/000000.txt").camera_from_lidar
    )
    rows = [line.split() for line in text.splitlines() if not line.startswith("DontCare")]
    for row in rows:
        place = np.array([*map(float, row[11:14]), 1.0])
        place[1] -= at_centre * float(row[8]) / 2
        row[11:14] = [f"{value:.3f}" for value in (lidar_from_camera @ place)[:3]]
        row[14] = f"{-float(row[14]) - np.pi / 2:.3f}"
    return "\n".join(" ".join(row) for row in rows)


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        (
            lambda text: changed(text, 12, lambda row, y: y - float(row[8]) / 2),
            "y is the height of box centres",
        ),
        (lambda text: in_lidar(text, at_centre=True), "rotation_y is its yaw, of box centres"),
        (lambda text: in_lidar(text, at_centre=False), "rotation_y is its yaw, of box bottoms"),
        (
            lambda text: changed(changed(text, 4, lambda _, x: x / 2), 6, lambda _, x: x / 2),
            "",
        ),
        (
            lambda text: _times(text, range(4, 8), 0.5),
            "2D boxes are pixels of an image of half the size",
        ),
        (lambda text: _times(text, range(8, 11), 0.5), "sizes are halves"),
    ],
)
def test_the_convention_that_makes_boxes_fit_is_named(labels, change, cause):
    (doubt,) = doubts(change(labels))
    _, _, named = doubt.partition("; if ")
    assert cause in named
    assert bool(named) == bool(cause)


def _times(text: str, columns: range, factor: float) -> str:
    for column in columns:
        text = changed(text, column, lambda _, value: factor * value)
    return text

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.data.datasets.kitti_object import KittiObjectDataset
from sightline.data.formats.kitti_conversion import (
    kitti_from_detections,
    kitti_from_labels,
    labels_from_kitti,
)
from sightline.data.formats.kitti_labels import (
    KittiObjects,
    parse_objects,
    read_labels,
    read_results,
    write_objects,
)
from sightline.geometry.boxes2d import Boxes2D, pairwise_iou2d
from sightline.geometry.boxes3d import Boxes3D
from sightline.geometry.calibration import Calibration
from sightline.geometry.tilt import Tilt
from sightline.structures.predictions import Detections2D, Detections3D
from tests.data.trees import LABELS, calibration
from tests.geometry.cameras import IMAGE_FROM_CAMERA, kitti_like_calibration
from tests.reference import image_boxes as reference

sizes = st.floats(0.1, 20)
places = st.floats(-100, 100)
turns = st.floats(-3.14, 3.14)
objects = st.lists(st.tuples(sizes, sizes, sizes, places, places, places, turns), max_size=4)
SIZE = (375, 1242)
boxes = st.tuples(
    st.floats(-20, 80), st.floats(-30, 30), st.floats(-3, 2),
    st.floats(0.3, 16), st.floats(0.3, 3), st.floats(0.3, 4), st.floats(-3.14, 3.14),
)  # fmt: skip


def columns(rows: list[tuple[float, ...]]) -> KittiObjects:
    table = np.array(rows, dtype=np.float64).reshape(-1, 7)
    count = len(table)
    return KittiObjects(
        class_names=("Car",) * count,
        truncation=np.zeros(count),
        occlusion=np.zeros(count),
        alpha=np.zeros(count),
        boxes2d=np.tile([1.0, 2.0, 3.0, 4.0], (count, 1)),
        dimensions_hwl=table[:, :3],
        locations=table[:, 3:6],
        rotation_y=table[:, 6],
    )


@given(rows=objects)
def test_boxes_survive_the_way_to_the_lidar_frame_and_back(rows):
    written = columns(rows)
    back = kitti_from_labels(labels_from_kitti(written, calibration()), calibration())
    for name in ("dimensions_hwl", "locations", "rotation_y", "boxes2d"):
        np.testing.assert_allclose(getattr(back, name), getattr(written, name), atol=1e-9)
    assert back.class_names == written.class_names


def test_an_object_without_a_3d_part_has_a_row_of_zeros_and_its_placeholders_come_back():
    read = parse_objects(LABELS.encode(), "0.txt", with_scores=False)
    labels = labels_from_kitti(read, calibration())
    assert labels.has_box3d.tolist() == [True, False]
    assert not labels.boxes3d.tensor[1].any()
    back = kitti_from_labels(labels, calibration())
    assert back.dimensions_hwl[1].tolist() == [-1, -1, -1]
    assert back.locations[1].tolist() == [-1000, -1000, -1000]
    assert back.rotation_y[1] == -10


@pytest.mark.parametrize("row", [(1.5, 1.6, 3.9, *[-1000.0] * 3, 0.0), (0, 1.6, 3.9, 1, 2, 9, 0)])
def test_half_a_3d_part_is_none(row):
    assert not labels_from_kitti(columns([row]), calibration()).boxes3d.tensor.any()


def test_convention_the_centre_is_half_the_height_above_kittis_bottom_and_length_comes_first():
    labels = labels_from_kitti(columns([(2.0, 1.6, 3.9, 0.1, 1.0, 9.7, 0.0)]), calibration())
    # The camera of these tests sits at x = 0.3, y = 0.1, z = -0.2 and looks along the LiDAR's x.
    expected = torch.tensor([[10.0, 0.0, -0.2, 3.9, 1.6, 2.0, -math.pi / 2]], dtype=torch.float64)
    torch.testing.assert_close(labels.boxes3d.tensor, expected)


def test_a_frame_without_objects_has_labels_of_length_zero():
    labels = labels_from_kitti(columns([]), calibration())
    assert len(labels) == 0
    assert labels.boxes3d.tensor.shape == (0, 7)
    assert len(kitti_from_labels(labels, calibration())) == 0


def found_3d(rows, dtype=torch.float64):
    table = torch.tensor(rows, dtype=dtype).reshape(-1, 7)
    names = tuple(f"Kind{number}" for number in range(len(table)))
    return Detections3D(
        class_names=names, boxes=Boxes3D(table), scores=torch.linspace(-1, 2, len(table))
    )


def found_2d(rows):
    table = torch.tensor(rows).reshape(-1, 4)
    names = ("Car",) * len(table)
    return Detections2D(
        class_names=names, boxes=Boxes2D(table), scores=torch.linspace(0, 1, len(table))
    )


@given(rows=st.lists(boxes, max_size=4))
def test_3d_detections_become_rows_in_the_camera_frame_where_the_image_shows_them(rows):
    results = kitti_from_detections(found_3d(rows), kitti_like_calibration(), SIZE)
    expected = []
    for number, (x, y, z, length, width, height, yaw) in enumerate(rows):
        # The mount of the tests' camera: its axes are those of the LiDAR, renamed.
        place = (-y - 0.01, -z - 0.08 + height / 2, x - 0.27)
        rotation_y = math.remainder(-yaw - math.pi / 2, 2 * math.pi)
        size = (height, width, length)
        box = reference.image_box(size, place, rotation_y, IMAGE_FROM_CAMERA, SIZE)
        if box is not None:
            expected.append((f"Kind{number}", size, place, rotation_y, box))
    assert results.class_names == tuple(row[0] for row in expected)
    for index, (_, size, place, rotation_y, box) in enumerate(expected):
        np.testing.assert_allclose(results.dimensions_hwl[index], size)
        np.testing.assert_allclose(results.locations[index], place, atol=1e-9)
        np.testing.assert_allclose(results.boxes2d[index], box, atol=1e-6)
        alpha = rotation_y - math.atan2(place[0], place[2])
        turned = results.rotation_y[index] - rotation_y, results.alpha[index] - alpha
        assert all(abs(math.remainder(angle, 2 * math.pi)) < 1e-9 for angle in turned)
        assert -math.pi <= results.alpha[index] < math.pi
    assert set(results.truncation) | set(results.occlusion) <= {-1.0}


def pitched_calibration(pitch_deg, roll_deg):
    """A camera that looks down and leans, at the LiDAR's place."""
    camera_from_level = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    tilt = Tilt(roll_deg=roll_deg, pitch_deg=pitch_deg).level_from_lidar[:3, :3]
    matrix = np.eye(4)
    matrix[:3, :3] = camera_from_level @ tilt.T
    return Calibration(
        image_from_camera=torch.tensor(IMAGE_FROM_CAMERA, dtype=torch.float64),
        camera_from_lidar=torch.from_numpy(matrix),
    )


def bounds_of_the_true_corners(row, calibration):
    """The bounds of the eight corners, one by one, of a box in the LiDAR frame."""
    x, y, z, length, width, height, yaw = row
    pixels = []
    for ahead in (-length / 2, length / 2):
        for aside in (-width / 2, width / 2):
            for up in (-height / 2, height / 2):
                place = (
                    x + ahead * math.cos(yaw) - aside * math.sin(yaw),
                    y + ahead * math.sin(yaw) + aside * math.cos(yaw),
                    z + up,
                    1.0,
                )
                seen = calibration.image_from_camera.numpy() @ (
                    calibration.camera_from_lidar.numpy() @ np.array(place)
                )
                pixels.append((seen[0] / seen[2], seen[1] / seen[2]))
    columns, rows = zip(*pixels, strict=True)
    return [min(columns), min(rows), max(columns), max(rows)]


@given(
    pitch_deg=st.floats(1.5, 12.0),
    roll_deg=st.floats(-5.0, 5.0),
    ahead=st.floats(12, 40),
    yaw=st.floats(-3.1, 3.1),
)
def test_boxes_of_a_camera_that_looks_down_bound_the_true_corners(pitch_deg, roll_deg, ahead, yaw):
    calibration = pitched_calibration(pitch_deg, roll_deg)
    row = (ahead, 1.0, -0.9, 4.2, 1.7, 1.6, yaw)
    results = kitti_from_detections(found_3d([row]), calibration, (4000, 4000))
    expected = bounds_of_the_true_corners(row, calibration)
    if min(expected) > 0:
        np.testing.assert_allclose(results.boxes2d[0], expected, atol=1e-6)


def test_convention_boxes_stay_upright_in_a_camera_tilted_as_little_as_kittis():
    row = (12.0, 1.0, -0.9, 4.2, 1.7, 1.6, 0.4)
    slightly, more = (
        kitti_from_detections(found_3d([row]), pitched_calibration(pitch_deg, 0.0), SIZE)
        for pitch_deg in (0.95, 1.05)
    )
    place, size = slightly.locations[0], slightly.dimensions_hwl[0]
    upright = reference.image_box(
        tuple(size), tuple(place), slightly.rotation_y[0], IMAGE_FROM_CAMERA, SIZE
    )
    np.testing.assert_allclose(slightly.boxes2d[0], upright, atol=1e-6)
    place = more.locations[0]
    upright = reference.image_box(
        tuple(size), tuple(place), more.rotation_y[0], IMAGE_FROM_CAMERA, SIZE
    )
    assert np.abs(more.boxes2d[0] - np.array(upright)).max() > 0.5


def test_what_is_found_survives_the_way_through_a_result_file(tmp_path):
    rows = [(20.0, 3.0, -1.0, 4.0, 1.6, 1.5, 0.4), (9.0, -4.0, -1.0, 0.8, 0.6, 1.8, -2.0)]
    calibration = kitti_like_calibration()
    found = found_3d(rows)
    results = kitti_from_detections(found, calibration, SIZE)
    write_objects(tmp_path / "000000.txt", results, decimals=None)
    back = read_results(tmp_path / "000000.txt")
    assert back.class_names == found.class_names
    np.testing.assert_array_equal(back.scores, found.scores.double().numpy())
    labels = labels_from_kitti(back, calibration)
    torch.testing.assert_close(labels.boxes3d.tensor, found.boxes.tensor, rtol=0, atol=1e-9)


def test_2d_detections_are_cut_at_the_image_and_have_no_3d_part():
    rows = [[-5.0, 10.0, 50.0, 500.0], [-30.0, 10.0, -1.0, 50.0], [5.0, 6.0, 7.0, 8.0]]
    results = kitti_from_detections(found_2d(rows), kitti_like_calibration(), SIZE)
    np.testing.assert_array_equal(results.boxes2d, [[0, 10, 50, 374], [5, 6, 7, 8]])
    np.testing.assert_array_equal(results.scores, [0, 1])
    assert set(results.alpha) | set(results.rotation_y) == {-10.0}
    assert results.dimensions_hwl.tolist() == [[-1] * 3] * 2
    assert results.locations.tolist() == [[-1000] * 3] * 2


def test_2d_detections_of_a_network_in_training_are_written():
    boxes = Boxes2D(torch.tensor([[5.0, 6.0, 7.0, 8.0]], requires_grad=True))
    found = replace(found_2d([[5.0, 6.0, 7.0, 8.0]]), boxes=boxes)
    results = kitti_from_detections(found, kitti_like_calibration(), SIZE)
    np.testing.assert_array_equal(results.boxes2d, [[5, 6, 7, 8]])


@pytest.mark.parametrize("found", [found_2d([]), found_3d([])])
def test_a_frame_without_detections_is_an_empty_file(tmp_path, found):
    results = kitti_from_detections(found, kitti_like_calibration(), SIZE)
    write_objects(tmp_path / "000000.txt", results)
    assert (tmp_path / "000000.txt").read_bytes() == b""
    assert len(read_results(tmp_path / "000000.txt")) == 0


def test_float32_detections_are_written_too():
    found = found_3d([(20.0, 3.0, -1.0, 4.0, 1.6, 1.5, 0.4)], torch.float32)
    results = kitti_from_detections(found, kitti_like_calibration(), SIZE)
    assert results.boxes2d.dtype == np.float64
    assert len(results) == 1


def test_real_labels_written_as_detections_have_the_labels_boxes_and_angles(kitti_root):
    dataset = KittiObjectDataset(kitti_root, parts={"image", "objects"})
    overlaps, turns = [], []
    for index in range(20):
        sample = dataset[index]
        label = read_labels(kitti_root / "training" / "label_2" / f"{sample.sample_id}.txt")
        objects = sample.objects.select(sample.objects.has_box3d)
        found = Detections3D(
            class_names=objects.class_names,
            boxes=objects.boxes3d,
            scores=torch.arange(len(objects)).double(),
        )
        results = kitti_from_detections(found, sample.calibration, sample.image_size)
        kept = results.scores.astype(int)
        ours, theirs = Boxes2D(torch.tensor(results.boxes2d)), Boxes2D(objects.boxes2d.tensor[kept])
        overlaps += pairwise_iou2d(ours, theirs).diagonal().tolist()
        real_alpha = label.alpha[sample.objects.has_box3d.numpy()][kept]
        turns += np.abs(np.angle(np.exp(1j * (results.alpha - real_alpha)))).tolist()
    assert np.median(overlaps) > 0.9
    assert np.median(turns) < 0.02

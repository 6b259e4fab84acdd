import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.data.kitti_labels import KittiObjects, parse_objects
from sightline.data.object_labels import kitti_from_labels, labels_from_kitti
from tests.data.trees import LABELS, calibration

sizes = st.floats(0.1, 20)
places = st.floats(-100, 100)
turns = st.floats(-3.14, 3.14)
objects = st.lists(st.tuples(sizes, sizes, sizes, places, places, places, turns), max_size=4)


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

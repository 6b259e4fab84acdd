import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from sightline.data.formats.image_header import read_image_size
from sightline.data.formats.kitti_boxes import box_corners, project_box
from sightline.data.formats.kitti_calibration import read_object_matrices
from sightline.data.formats.kitti_labels import read_labels
from sightline.geometry.image_boxes import kitti_corners, project_boxes
from sightline.simulation.settings import SimulationConfig
from sightline.simulation.simulator import calibration_of
from tests.reference import label_boxes as reference

SIZE = (375, 1242)
CAMERA = calibration_of(SimulationConfig()).image_from_camera


def projected(location, size_hwl, rotation_y: float, image_size=SIZE):
    corners = box_corners(np.array(location), np.array(size_hwl), rotation_y)
    return project_box(corners, CAMERA, image_size)


@settings(max_examples=60)
@given(
    x=st.floats(-14, 14),
    y=st.floats(0.5, 3),
    z=st.floats(-4, 40),
    size_hwl=st.tuples(st.floats(0.5, 4), st.floats(0.5, 3), st.floats(0.5, 10)),
    rotation_y=st.floats(-3.2, 3.2),
)
def test_a_box_bounds_what_the_image_shows_of_its_edges(x, y, z, size_hwl, rotation_y):
    box, truncation = projected((x, y, z), size_hwl, rotation_y)
    expected, share = reference.project_box((x, y, z), size_hwl, rotation_y, CAMERA, SIZE)
    if expected is None:
        assert truncation == 1 or np.isnan(box).all() or (box[2:] - box[:2]).min() < 30
        return
    # The reference looks at places of the edges, none of which may be left out.
    assert (box[:2] <= np.array(expected[:2]) + 1e-6).all()
    assert (box[2:] >= np.array(expected[2:]) - 1e-6).all()
    nearest = z - np.hypot(*size_hwl[1:]) / 2
    if nearest > 1:
        step_px = max(size_hwl) / 2000 * 2000 / nearest  # 2000: px a radian far from the centre
        assert box == pytest.approx(expected, abs=step_px)
        assert truncation == pytest.approx(share, abs=0.02)


@given(st.floats(-3.2, 3.2), st.floats(-4, 4))
def test_what_is_wholly_inside_is_not_truncated_at_all(rotation_y: float, x: float):
    box, truncation = projected((x, 1.6, 20.0), (1.5, 1.6, 4.0), rotation_y)
    assert truncation == 0
    assert 0 < box[0] < box[2] < SIZE[1] - 1


@given(
    x=st.floats(-20, 20),
    y=st.floats(-1, 3),
    z=st.floats(-4, 60),
    size_hwl=st.tuples(st.floats(0.5, 4), st.floats(0.5, 3), st.floats(0.5, 10)),
    rotation_y=st.floats(-3.2, 3.2),
)
def test_a_box_is_the_one_that_detections_get_by_pytorch(x, y, z, size_hwl, rotation_y):
    given_box = (torch.tensor([value], dtype=torch.float64) for value in (size_hwl, (x, y, z)))
    corners = kitti_corners(*given_box, torch.tensor([rotation_y], dtype=torch.float64))
    theirs = project_boxes(corners, torch.from_numpy(CAMERA), SIZE).tensor[0].numpy()
    ours, _ = projected((x, y, z), size_hwl, rotation_y)
    np.testing.assert_allclose(ours, theirs, atol=1e-6)


def test_a_corner_behind_the_camera_makes_the_truncation_1_and_the_box_ends_at_the_image():
    box, truncation = projected((3.0, 1.6, 1.0), (1.5, 1.6, 4.0), -np.pi / 2)
    assert truncation == 1
    assert box[2:].tolist() == [SIZE[1] - 1, SIZE[0] - 1]
    assert 0 < box[0] < SIZE[1] - 1


def test_a_box_outside_the_image_shows_nothing():
    for location in ((30.0, 1.6, 10.0), (0.0, 1.6, -10.0)):
        box, truncation = projected(location, (1.5, 1.6, 4.0), 0.3)
        assert np.isnan(box).all()
        assert truncation == 1


def test_real_labels_are_drawn_so(kitti_root):
    ious, errors = [], []
    for path in sorted((kitti_root / "training/label_2").glob("*.txt")):
        size = read_image_size(kitti_root / f"training/image_2/{path.stem}.png")
        matrices = read_object_matrices(kitti_root / f"training/calib/{path.stem}.txt")
        objects = read_labels(path)
        for row, name in enumerate(objects.class_names):
            if name in ("Car", "Van", "Cyclist"):
                box, truncation = project_box(
                    box_corners(
                        objects.locations[row],
                        objects.dimensions_hwl[row],
                        float(objects.rotation_y[row]),
                    ),
                    matrices.image_from_camera,
                    size,
                )
                labelled = objects.boxes2d[row]
                overlap = np.minimum(box, labelled)[2:] - np.maximum(box, labelled)[:2]
                areas = [np.prod(one[2:] - one[:2]) for one in (box, labelled)]
                ious.append(np.prod(overlap) / (sum(areas) - np.prod(overlap)))
                if objects.truncation[row] > 0:
                    errors.append(abs(truncation - objects.truncation[row]))
    assert np.median(ious) > 0.97
    assert np.quantile(ious, 0.05) > 0.93
    assert np.median(errors) < 0.01

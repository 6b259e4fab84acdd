"""Distances of image boxes by regression: its columns, its fit and its file."""

import dataclasses
import json
import math

import numpy as np
import pytest
import torch

from sightline.files.problem import FileError
from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.boxes3d import Boxes3D
from sightline.joining.models import CLASSES
from sightline.joining.range_fitting import fit_ranges, robust_fit
from sightline.joining.ranges import RANGE_COLUMNS, predict_ranges, range_columns, read_ranges
from sightline.joining.scene import project_upright
from sightline.structures.labels import ObjectLabels
from tests.joining.scenes import CALIBRATION, make_sample

CAMERA = CALIBRATION.image_from_camera.numpy()
SIZE = (375, 1242)
SIZES = {"Car": (3.88, 1.63, 1.7), "Pedestrian": (0.84, 0.66, 1.9), "Cyclist": (1.76, 0.6, 1.9)}
"""Higher than the classes' means: the geometry alone takes them for nearer."""


def columns_of(box, road_m=20.0):
    (row,) = range_columns(np.array([box]), SIZE, CAMERA, np.array([road_m]))
    return dict(zip(RANGE_COLUMNS, row.tolist(), strict=True))


def test_columns_tell_size_place_and_borders_of_a_box():
    found = columns_of((584.0, 150.0, 728.0, 222.0))
    z, r = math.log(10), math.log(20 / 16)
    assert found["1"] == 1
    assert found["z"] == pytest.approx(z)
    assert found["r"] == pytest.approx(r)
    assert found["r z"] == pytest.approx(r * z)
    assert found["r r r"] == pytest.approx(r**3)
    assert found["a a"] == pytest.approx(math.log(2) ** 2)
    assert found["aside"] == pytest.approx(36 / 720)
    assert (found["side"], found["bottom"], found["top"]) == (0, 0, 0)


@pytest.mark.parametrize(
    ("box", "cut"),
    [
        ((0.0, 150.0, 144.0, 222.0), (1, 0, 0)),
        ((1100.0, 150.0, 1241.0, 222.0), (1, 0, 0)),
        ((584.0, 150.0, 728.0, 374.0), (0, 1, 0)),
        ((584.0, 0.0, 728.0, 222.0), (0, 0, 1)),
    ],
)
def test_borders_that_cut_a_box_are_told(box, cut):
    found = columns_of(box)
    assert (found["side"], found["bottom"], found["top"]) == cut


@pytest.mark.parametrize(("road_m", "r"), [(math.nan, 1.5), (90.0, 1.5), (2.0, -1.5)])
def test_a_road_far_from_the_height_or_nowhere_is_limited(road_m, r):
    assert columns_of((584.0, 150.0, 728.0, 222.0), road_m)["r"] == pytest.approx(r)


def test_the_fit_is_exact_and_outliers_hardly_change_it():
    rng = np.random.default_rng(0)
    rows = np.column_stack((np.ones(400), rng.standard_normal((400, 2))))
    target = rows @ np.array([0.3, -0.2, 0.1])
    np.testing.assert_allclose(robust_fit(rows, target), [0.3, -0.2, 0.1], atol=1e-3)
    target[::10] += 3.0
    np.testing.assert_allclose(robust_fit(rows, target), [0.3, -0.2, 0.1], atol=0.02)


def labelled(seed):
    """A frame with objects of all classes, larger than usual, on the road."""
    rng = np.random.default_rng(seed)
    names = CLASSES * 4
    x, y = rng.uniform(8, 40, len(names)), rng.uniform(-0.2, 0.2, len(names))
    sizes = np.array([SIZES[name] for name in names])
    heights = sizes[:, 2] / 2 - 1.73
    boxes = Boxes3D(torch.from_numpy(np.column_stack((x, x * y, heights, sizes, np.zeros(len(x))))))
    return make_sample(
        objects=ObjectLabels(
            class_names=names,
            boxes2d=Boxes2D(torch.from_numpy(project_upright(boxes, make_sample()))),
            boxes3d=boxes,
            truncation=torch.zeros(len(names)).double(),
            alpha=torch.full((len(names),), -10.0).double(),
            occlusion=torch.zeros(len(names), dtype=torch.int64),
        )
    )


def test_a_fit_learns_the_sizes_of_the_labels():
    weights = fit_ranges(labelled(seed) for seed in range(30))
    assert weights == fit_ranges(labelled(seed) for seed in range(30))
    sample = labelled(99)
    assert sample.objects is not None
    depths = sample.objects.boxes3d.tensor[:, 0].numpy() - 0.27
    boxes = sample.objects.boxes2d.tensor.numpy()
    falling = (187 - boxes[:, 3]) / 720
    road_m = (1.73 - 0.08) / -falling
    rows = range_columns(boxes, SIZE, CAMERA, road_m)
    for place, name in enumerate(sample.objects.class_names):
        (found,) = predict_ranges(rows[place : place + 1], weights[name])
        assert found == pytest.approx(depths[place], rel=0.06)


def test_frames_without_labels_or_without_a_class_are_refused():
    with pytest.raises(ValueError, match="no labels"):
        fit_ranges([make_sample()])
    sample = labelled(0)
    cars = dataclasses.replace(
        sample.objects, class_names=("Car",) * len(sample.objects.class_names)
    )
    with pytest.raises(ValueError, match="class Pedestrian"):
        fit_ranges([dataclasses.replace(sample, objects=cars)])


def test_the_included_weights_are_of_all_classes():
    assert set(read_ranges()) == set(CLASSES)


@pytest.mark.parametrize(
    "content", ["", "[]", "{}", '{"ranges": {"Car": [1.0]}}', '{"ranges": {"Car": ["x"]}}',
                json.dumps({"ranges": {"Car": [math.nan] * len(RANGE_COLUMNS)}})]
)  # fmt: skip
def test_a_file_of_other_weights_is_refused(tmp_path, content):
    path = tmp_path / "ranges.json"
    path.write_text(content)
    with pytest.raises(FileError, match="weights of each class"):
        read_ranges(path)

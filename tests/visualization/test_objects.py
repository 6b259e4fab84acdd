"""Pictures of joined objects: each once, with marks for sensors and origin."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.boxes3d import Boxes3D
from sightline.structures.objects import Objects
from sightline.structures.predictions import Perception
from sightline.visualization.birds_eye import BirdsEyeView, draw_birds_eye
from sightline.visualization.colors import BoxStyle
from sightline.visualization.frame_row import RowLayout, draw_row
from sightline.visualization.objects import box_styles, draw_objects, support_marks
from sightline.visualization.sheet import frame_sheet
from tests.visualization.test_rerun_file import some_perception


def some_objects(*, lifted=False):
    """Objects found by both detectors, by one of each, and in the image without a 3D box."""
    nan = [torch.nan] * 4
    boxes2d = [
        [150.0, 40.0, 240.0, 90.0],
        nan,
        [20.0, 30.0, 90.0, 80.0],
        [300.0, 20.0, 340.0, 99.0],
    ]
    boxes3d = [[12.0, 0, -0.9, 4, 1.7, 1.5, 0.3], [-15.0, 1, -0.9, 4, 1.7, 1.5, 0.3], [0.0] * 7]
    boxes3d.insert(2, [14.0, 5, -0.9, 4, 1.7, 1.5, 0.0])
    return Objects(
        class_names=("Car", "Cyclist", "Car", "Pedestrian"),
        boxes2d=Boxes2D(torch.tensor(boxes2d).double()),
        boxes3d=Boxes3D(torch.tensor(boxes3d).double()),
        origins=("lifted" if lifted else "measured", "measured", "lifted", "none"),
        scores=torch.tensor([0.9, 0.8, 0.7, 0.6]).double(),
        scores3d=torch.tensor([0.9, 0.8, 0.2, 0.0]).double(),
        image_support=torch.tensor([0.5, 0.0, 0.7, 0.6]).double(),
        lidar_support=torch.tensor([0.5, 0.8, 0.0, 0.0]).double(),
        num_points=torch.tensor([100, 5, 3, 0]),
    )


@pytest.mark.parametrize(
    ("image", "marks"),
    [("as it is", ("C+L", "L", "C", "C")), ("black", ("L",) * 4), (None, ("L",) * 4)],
)
def test_a_camera_without_a_picture_supports_nothing(sample, image, marks):
    if image != "as it is":
        image = None if image is None else torch.zeros_like(sample.image)
        sample = replace(sample, image=image)
    assert support_marks(some_objects(), sample) == marks


def test_lifted_boxes_are_dashed_and_those_of_both_sensors_filled(sample):
    styles = box_styles(some_objects(), sample)
    assert [style.is_dashed for style in styles] == [False, False, True, False]
    assert [style.is_filled for style in styles] == [True, False, False, False]


def test_a_lifted_box_has_gaps_in_its_edges(sample, black):
    solid, dashed = (
        draw_objects(black, some_objects(lifted=lifted).select(torch.tensor([0])), sample)
        for lifted in (False, True)
    )
    assert 0 < (dashed > 0).sum() < (solid > 0).sum()


def test_dashes_and_filling_are_seen_from_above():
    boxes = Boxes3D(torch.tensor([[12.0, 0.0, -0.9, 4.0, 1.7, 1.5, 0.3]]))
    drawn = [
        draw_birds_eye(None, boxes, ("Car",), view=BirdsEyeView(), styles=[style])
        for style in (
            BoxStyle(),
            BoxStyle(is_filled=False),
            BoxStyle(is_dashed=True, is_filled=False),
        )
    ]
    empty = draw_birds_eye(None, view=BirdsEyeView())
    changed = [(each != empty).any(axis=-1).sum() for each in drawn]
    assert changed[0] > changed[1] > changed[2] > 0
    assert np.array_equal(drawn[0], draw_birds_eye(None, boxes, ("Car",), view=BirdsEyeView()))


def test_an_object_behind_the_camera_is_not_drawn_and_one_without_a_3d_box_outlined(sample, black):
    alone = some_objects().select(torch.tensor([1]))
    assert np.array_equal(draw_objects(black, alone, sample), black)
    in_image = some_objects().select(torch.tensor([3]))
    assert draw_objects(black, in_image, sample)[60, 299:302].any()  # the outline's left side


def test_objects_replace_detections_on_pages(sample):
    layout = RowLayout.of(sample.image_size)
    found = some_perception(sample)
    objects = some_objects()
    alone = Perception(objects=objects, depth=found.depth)
    both = replace(found, objects=objects)
    rows = [draw_row(sample, each, layout) for each in (alone, both, found)]
    assert np.array_equal(rows[0], rows[1])
    assert not np.array_equal(rows[0], rows[2])
    sheets = [
        frame_sheet(sample, objects=objects),
        frame_sheet(
            sample,
            objects=objects,
            detections2d=found.detections2d,
            detections3d=found.detections3d,
        ),
        frame_sheet(sample),
    ]
    assert np.array_equal(sheets[0], sheets[1])
    assert not np.array_equal(sheets[0], sheets[2])

"""Page of a frame, with all parts and with missing ones."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from sightline.data.open import open_dataset
from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.boxes3d import Boxes3D
from sightline.structures.labels import ObjectLabels
from sightline.structures.predictions import DepthMap, Detections2D, Detections3D
from sightline.visualization.colors import class_color
from sightline.visualization.object_table import draw_object_table
from sightline.visualization.sheet import frame_sheet


def depth_map(size):
    return DepthMap(depth_m=torch.full(size, 12.0), valid=torch.ones(size, dtype=torch.bool))


def assert_is_picture(page):
    assert page.dtype == np.uint8
    assert page.ndim == 3
    assert page.shape[2] == 3
    assert page.shape[1] == 1900


def test_a_page_grows_by_a_panel_for_each_depth_map_that_is_there(sample):
    three = frame_sheet(sample)
    four = frame_sheet(sample, depth_map(sample.image_size))
    truth = torch.full(sample.image_size, 11.0)
    five = frame_sheet(replace(sample, depth=truth), depth_map(sample.image_size))
    for page in (three, four, five):
        assert_is_picture(page)
    panel = four.shape[0] - three.shape[0]
    assert panel > 1242 * 120 / 400
    assert five.shape[0] - four.shape[0] == panel
    assert frame_sheet(replace(sample, depth=truth)).shape == four.shape


def test_labels_are_no_detections_from_above_either(sample):
    """With 2D detections only, the boxes in the bird's-eye view are labels."""
    nothing = Detections2D(class_names=(), boxes=Boxes2D(torch.zeros(0, 4)), scores=torch.zeros(0))
    blue = np.array(class_color("Car"))

    def coloured(page):
        return (page[:, -360:] == blue).all(axis=2).sum()

    assert coloured(frame_sheet(sample)) > coloured(frame_sheet(sample, detections2d=nothing)) == 0


def test_the_errors_that_a_network_expects_have_a_panel_of_their_own(sample):
    dense = depth_map(sample.image_size)
    error_m = torch.full(sample.image_size, 0.4)
    error_m[:10] = torch.inf  # without a value
    plain = frame_sheet(sample, dense)
    page = frame_sheet(sample, replace(dense, uncertainty_m=error_m))
    assert_is_picture(page)
    assert page.shape[0] - plain.shape[0] > 1242 * 120 / 400


@pytest.mark.parametrize("part", ["image", "points", "objects"])
def test_a_page_is_made_without_a_part(sample, part):
    whole, lacking = frame_sheet(sample), frame_sheet(replace(sample, **{part: None}))
    assert_is_picture(lacking)
    assert (whole.shape != lacking.shape) or (whole != lacking).any()


def test_a_page_is_made_of_nothing_but_a_calibration(sample):
    assert_is_picture(frame_sheet(replace(sample, image=None, points=None, objects=None)))


def test_a_sweep_of_zero_points_and_a_frame_of_zero_objects_are_shown(sample):
    none = torch.zeros(2, dtype=torch.bool)
    empty = replace(sample, points=torch.zeros(0, 4), objects=sample.objects.select(none))
    assert_is_picture(frame_sheet(empty, depth_map(sample.image_size)))


@pytest.mark.parametrize("size", [(375, 1242), (48, 64), (300, 100), (900, 1600)])
def test_pages_of_any_image_size_have_one_width(sample, size):
    scaled = replace(
        sample,
        image_size=size,
        image=torch.zeros(3, *size, dtype=torch.uint8),
        calibration=sample.calibration.resize(size[1] / 400, size[0] / 120),
    )
    assert_is_picture(frame_sheet(scaled, depth_map(size)))


def test_detections_are_shown_with_labels_beside_them(sample):
    labelled = frame_sheet(sample)
    page = frame_sheet(
        sample,
        detections2d=Detections2D(
            class_names=("Cyclist",),
            boxes=Boxes2D(torch.tensor([[200.0, 30.0, 260.0, 80.0]])),
            scores=torch.tensor([0.5]),
        ),
        detections3d=Detections3D(
            class_names=("Cyclist",),
            boxes=Boxes3D(torch.tensor([[14.0, 1.0, -0.9, 1.8, 0.6, 1.7, 0.1]])),
            scores=torch.tensor([0.5]),
        ),
    )
    assert page.shape == labelled.shape
    assert (page != labelled).any()


def test_a_dense_depth_of_another_size_is_refused(sample):
    with pytest.raises(ValueError, match=r"dense depth is 10x20 .* expected 120x400"):
        frame_sheet(sample, depth_map((10, 20)))


def test_the_sample_is_left_as_it_is(sample):
    image, points = sample.image.clone(), sample.points.clone()
    frame_sheet(sample)
    assert (sample.image == image).all()
    assert (sample.points == points).all()


def test_a_table_counts_what_has_no_room():
    num_objects = 12
    boxes = torch.tensor([[10.0, 0.0, 0.0, 4.0, 2.0, 1.5, 0.0]]).repeat(num_objects, 1)
    found = Detections3D(
        class_names=("Car",) * num_objects,
        boxes=Boxes3D(boxes),
        scores=torch.linspace(0, 1, num_objects),
    )
    whole = draw_object_table(found, None, width_px=600, max_height_px=1000)
    short = draw_object_table(found, None, width_px=600, max_height_px=130)
    assert short.shape[0] <= 130 < whole.shape[0]


def test_real_frames_are_shown(kitti_root):
    dataset = open_dataset(kitti_root, sample_list=["000008", "000010"])
    for index in range(2):
        assert_is_picture(frame_sheet(dataset[index]))


@pytest.mark.parametrize("size", [(375, 1), (1, 375), (5000, 1), (1, 1)])
def test_a_page_of_a_very_narrow_image_is_no_larger_than_others(sample, size):
    tiny = replace(
        sample,
        image_size=size,
        image=torch.zeros(3, *size, dtype=torch.uint8),
        depth=torch.ones(size),
    )
    page = frame_sheet(tiny, depth_map(size))
    assert_is_picture(page)
    assert page.shape[0] < 5 * 1242


def many_objects(count):
    """Labels of cars one behind the other, the farthest first."""
    boxes3d = torch.tensor([[0.0, 0.0, 0.0, 4.0, 2.0, 1.5, 0.0]]).repeat(count, 1)
    boxes3d[:, 0] = torch.arange(count, 0, -1) * 0.1
    return ObjectLabels(
        class_names=("Car",) * count,
        boxes2d=Boxes2D(torch.tensor([[1.0, 2.0, 9.0, 9.0]]).repeat(count, 1)),
        boxes3d=Boxes3D(boxes3d),
        truncation=torch.zeros(count, dtype=torch.float64),
        occlusion=torch.zeros(count, dtype=torch.int64),
        alpha=torch.zeros(count, dtype=torch.float64),
    )


def test_of_very_many_labels_the_nearest_are_drawn_and_the_page_says_so(sample):
    crowd, near = many_objects(10_000), many_objects(500)
    page = frame_sheet(replace(sample, objects=crowd))
    alone = frame_sheet(replace(sample, objects=near))
    head = 46  # height of the head, which counts the other objects
    assert np.array_equal(page[head:], alone[head:])
    assert not np.array_equal(page[:head], alone[:head])


def test_of_very_many_detections_the_surest_are_drawn(sample):
    scores = torch.linspace(0, 1, 2000)
    boxes2d = Boxes2D(torch.tensor([[1.0, 2.0, 9.0, 9.0]]).repeat(2000, 1))
    boxes3d = many_objects(2000).boxes3d
    names = ("Car",) * 2000
    found = {
        "detections2d": Detections2D(class_names=names, boxes=boxes2d, scores=scores),
        "detections3d": Detections3D(class_names=names, boxes=boxes3d, scores=scores),
    }
    kept = torch.arange(1500, 2000)
    best = {
        "detections2d": Detections2D(
            class_names=names[:500], boxes=boxes2d[kept], scores=scores[kept]
        ),
        "detections3d": Detections3D(
            class_names=names[:500], boxes=boxes3d[kept], scores=scores[kept]
        ),
    }
    assert np.array_equal(frame_sheet(sample, **found), frame_sheet(sample, **best))

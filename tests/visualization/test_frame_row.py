"""Pictures of frames: of one size, with notices for missing parts."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from sightline.structures.predictions import DepthMap, Perception
from sightline.visualization.frame_row import RowLayout, draw_row, draw_rows
from tests.visualization.test_rerun_file import some_perception


@pytest.mark.parametrize("size", [(375, 1242), (1200, 1920), (1, 300), (300, 1), (1080, 1080)])
def test_a_layout_has_even_sides_and_room_for_all(size):
    layout = RowLayout.of(size)
    assert all(side % 2 == 0 for side in layout.size)
    assert layout.camera_size[0] < layout.size[0]
    assert layout.size[1] < 2000


def test_pictures_are_of_the_layouts_size_for_any_image(sample):
    layout = RowLayout.of((375, 1242))
    for size in (sample.image_size, (60, 60)):
        image = torch.zeros(3, *size, dtype=torch.uint8)
        other = replace(sample, image_size=size, image=image, objects=None)
        assert draw_row(other, Perception(), layout).shape[:2] == layout.size


@pytest.mark.parametrize("part", ["image", "points"])
def test_a_missing_sensor_changes_the_picture_and_the_head(sample, part):
    layout = RowLayout.of(sample.image_size)
    whole = draw_row(sample, some_perception(sample), layout)
    lacking = draw_row(replace(sample, **{part: None}), some_perception(sample), layout)
    assert not np.array_equal(whole[:34], lacking[:34])
    assert not np.array_equal(whole[34:], lacking[34:])


def test_each_kind_of_result_changes_the_picture(sample):
    layout = RowLayout.of(sample.image_size)
    everything = some_perception(sample)
    whole = draw_row(sample, everything, layout)
    for kind in ("detections2d", "detections3d", "depth"):
        assert not np.array_equal(
            whole, draw_row(sample, replace(everything, **{kind: None}), layout)
        )


def test_untrusted_depth_is_drawn_as_missing(sample):
    layout = RowLayout.of(sample.image_size)
    depth_m = torch.full(sample.image_size, 12.0)
    nothing = DepthMap(depth_m=depth_m, valid=torch.zeros_like(depth_m, dtype=torch.bool))
    pages = [
        draw_row(sample, Perception(depth=depth), layout)
        for depth in (DepthMap(depth_m=depth_m, valid=depth_m > 0), nothing)
    ]
    middle = (layout.size[0] - 60, 200)
    assert pages[0][middle].max() > 100
    assert pages[1][middle].max() < 30


@pytest.mark.parametrize(("count", "columns"), [(1, 1), (3, 1), (4, 2), (5, 2)])
def test_a_page_of_several_frames_has_room_for_each(sample, count, columns):
    page = draw_rows([(sample, Perception())] * count)
    height, width = RowLayout.of(sample.image_size).size
    assert page.shape[:2] == (-(-count // columns) * height, columns * width)


def test_a_page_of_no_frame_is_refused():
    with pytest.raises(ValueError, match="at least one frame"):
        draw_rows([])

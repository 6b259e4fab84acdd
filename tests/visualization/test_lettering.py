"""Text and tags."""

import numpy as np
import pytest

from sightline.visualization.lettering import Tag, put_tags, put_text, text_width, with_title


def test_text_stands_on_its_baseline_and_keeps_its_width():
    canvas = np.zeros((60, 200, 3), np.uint8)
    put_text(canvas, "HEH", 20, 40, height_px=20, color=(255, 255, 255))
    rows, columns = np.nonzero(canvas.max(axis=2) > 100)
    assert rows.max() == pytest.approx(39, abs=2)
    assert rows.max() - rows.min() + 1 == pytest.approx(20, abs=4)
    assert columns.min() >= 20
    assert columns.max() <= 20 + text_width("HEH", 20)


@pytest.mark.parametrize("place", [(-500, 20), (500, 20), (10, -50), (10, 500), (-5, 5), (195, 59)])
def test_text_beyond_the_border_is_cut(place):
    canvas = np.zeros((60, 200, 3), np.uint8)
    put_text(canvas, "Pedestrian", *place, height_px=12)
    assert canvas.shape == (60, 200, 3)


def test_tags_of_neighbouring_boxes_do_not_overlap():
    canvas = np.zeros((100, 300, 3), np.uint8)
    colors = [(255, 0, 0), (0, 255, 0), (0, 0, 255)]
    boxes = [(50.0 + step, 40.0, 120.0, 80.0) for step in range(3)]
    tags = [Tag(text="Car", color=color, box=box) for color, box in zip(colors, boxes, strict=True)]
    put_tags(canvas, tags, height_px=10)
    areas = [int((canvas == color).all(axis=2).sum()) for color in colors]
    assert min(areas) > 0.8 * max(areas) > 0


def test_a_tag_at_the_upper_border_moves_into_the_box():
    canvas = np.zeros((100, 300, 3), np.uint8)
    put_tags(
        canvas, [Tag(text="Car", color=(255, 0, 0), box=(50.0, 0.0, 120.0, 60.0))], height_px=10
    )
    rows, _ = np.nonzero((canvas == (255, 0, 0)).all(axis=2))
    assert rows.min() == 0
    assert rows.max() < 20


def test_tags_without_a_free_place_are_left_out():
    canvas = np.zeros((20, 40, 3), np.uint8)
    tag = Tag(text="Car", color=(255, 0, 0), box=(0.0, 0.0, 40.0, 20.0))
    put_tags(canvas, [tag] * 50, height_px=10)
    once = np.zeros((20, 40, 3), np.uint8)
    put_tags(once, [tag], height_px=10)
    assert (canvas == once).all()


def test_a_title_stands_above_the_picture_which_stays_as_it_is():
    picture = np.full((30, 120, 3), 200, np.uint8)
    titled = with_title(picture, "depth, a title that is much too long", height_px=10)
    assert titled.shape == (50, 120, 3)
    assert (titled[20:] == picture).all()
    assert titled[:20].max() > 200

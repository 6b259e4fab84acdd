"""Bird's-eye views."""

import numpy as np
import pytest
import torch

from sightline.geometry.boxes3d import Boxes3D
from sightline.visualization.birds_eye import BirdsEyeView, draw_birds_eye
from sightline.visualization.colors import class_color

VIEW = BirdsEyeView(x_min_m=0.0, x_max_m=40.0, y_min_m=-20.0, y_max_m=20.0, pixels_per_m=10.0)


def test_ahead_is_up_and_left_is_left():
    assert VIEW.picture_size == (400, 400)
    assert VIEW.pixels(np.array([[39.95, 19.95], [0.05, -19.95]])) == pytest.approx(
        np.array([[0.0, 0.0], [399.0, 399.0]])
    )


def test_a_point_is_drawn_at_its_place():
    empty = draw_birds_eye(torch.zeros(0, 4), view=VIEW)
    picture = draw_birds_eye(torch.tensor([[33.05, -7.05, 1.0, 0.5]]), view=VIEW)
    rows, columns = np.nonzero((picture != empty).any(axis=2))
    assert rows.mean() == pytest.approx(69, abs=1)
    assert columns.mean() == pytest.approx(270, abs=1)


def test_a_cloud_looks_the_same_however_high_the_lidar_is_mounted():
    points = torch.rand(500, 4, generator=torch.Generator().manual_seed(0)) * 30
    higher = points - torch.tensor([0.0, 0.0, 2.0, 0.0])
    assert (draw_birds_eye(higher, view=VIEW) == draw_birds_eye(points, view=VIEW)).all()


def test_the_front_of_a_box_is_drawn_stronger_and_leads_on():
    box = Boxes3D(torch.tensor([[30.0, 0.0, 0.0, 6.0, 2.0, 1.5, 0.0]]))
    picture = draw_birds_eye(None, box, ["Car"], view=VIEW).astype(int)
    is_car = np.abs(picture - class_color("Car")).max(axis=2) < 40
    front, rear = 400 - 330, 400 - 270  # rows of x = 33 m and 27 m
    assert is_car[front - 12, 199:201].any()  # the line ahead of the front
    assert not is_car[rear + 12, 190:210].any()
    assert is_car[front - 2 : front + 3, 193:207].sum() > is_car[rear - 2 : rear + 3, 193:207].sum()


def test_boxes_without_a_size_or_a_place_or_far_away_are_left_out():
    size = [4.0, 2.0, 1.5, 0.0]
    boxes = Boxes3D(torch.tensor([[0.0] * 7, [1e9, 1e9, 0.0, *size], [torch.nan, 0.0, 0.0, *size]]))
    with_boxes = draw_birds_eye(None, boxes, ["DontCare", "Car", "Car"], view=VIEW)
    assert (with_boxes == draw_birds_eye(None, view=VIEW)).all()


def test_the_field_of_view_is_lighter_within_than_beside(calibration):
    picture = draw_birds_eye(None, calibration=calibration, image_size=(120, 400), view=VIEW)
    assert picture[150, 180].sum() > picture[350, 20].sum()  # 45 degrees to each side


def test_no_points_and_no_sweep_look_alike():
    assert (draw_birds_eye(None, view=VIEW) == draw_birds_eye(torch.zeros(0, 4), view=VIEW)).all()


def test_an_empty_view_is_refused():
    with pytest.raises(ValueError, match="x_min_m < x_max_m"):
        BirdsEyeView(x_min_m=10.0, x_max_m=10.0)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"x_max_m": float("nan")}, "all finite"),
        ({"y_max_m": float("inf")}, "all finite"),
        ({"pixels_per_m": float("nan")}, "all finite"),
        ({"x_min_m": 0.0, "x_max_m": 0.01}, "at least one pixel"),
    ],
)
def test_a_view_without_pixels_or_end_is_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        BirdsEyeView(**wrong)


@pytest.mark.parametrize("sides", [(15.0, 40.0), (-40.0, -20.0), (-2.0, 2.0)])
def test_rings_that_have_no_room_for_a_name_are_drawn_without(sides):
    view = BirdsEyeView(y_min_m=sides[0], y_max_m=sides[1], x_max_m=30.0, pixels_per_m=2.0)
    picture = draw_birds_eye(None, view=view)
    assert picture.shape == (*view.picture_size, 3)


def test_the_name_of_a_ring_beside_the_picture_darkens_nothing_in_it():
    view = BirdsEyeView(y_min_m=-40.0, y_max_m=-20.0, x_max_m=19.0, pixels_per_m=14.0)
    # As far from the right edge as the name of the 10 m ring would lie beyond the left one.
    points = torch.tensor([[6.75, -29.25, 0.0, 0.5], [16.75, -29.25, 0.0, 0.5]])
    picture = draw_birds_eye(points, view=view)
    drawn = [picture[row - 3 : row + 4, 120:140].max() for row in (171, 31)]
    assert drawn[0] == drawn[1] > 80


def test_the_name_of_a_ring_at_the_upper_edge_is_whole():
    def of_names(x_max_m):
        view = BirdsEyeView(y_min_m=-11.0, y_max_m=11.0, x_max_m=x_max_m, pixels_per_m=8.0)
        picture = draw_birds_eye(None, view=view)
        return (picture.min(axis=2) >= 100).sum()  # brighter than rings

    assert of_names(20.1) == pytest.approx(of_names(23.0), rel=0.02)  # a ring shines through


@pytest.mark.parametrize("names", [(), ("Car", "Car", "Car")])
def test_boxes_need_a_class_name_each(names):
    boxes = Boxes3D(torch.tensor([[30.0, 0.0, 0.0, 6.0, 2.0, 1.5, 0.0]] * 2))
    with pytest.raises(ValueError, match=f"2 boxes cannot be drawn with {len(names)} class names"):
        draw_birds_eye(None, boxes, names, view=VIEW)

"""Boxes and points on the image: changed and unchanged pixels."""

import numpy as np
import pytest
import torch

from sightline.geometry.boxes2d import Boxes2D
from sightline.geometry.boxes3d import Boxes3D
from sightline.visualization.colors import DEPTH_SCALE, class_color
from sightline.visualization.image import draw_boxes2d, draw_boxes3d, draw_points

CAR_AHEAD = [10.0, 1.0, -0.5, 4.0, 1.8, 1.5, 0.4]


def pixel_of(point: np.ndarray) -> tuple[int, int]:
    """Row and column of a LiDAR point, by the fixture's camera, computed independently."""
    x, y, z = point
    return round(59.5 - 200 * z / x), round(199.5 - 200 * y / x)


def corners_of(box: list[float]) -> np.ndarray:
    x, y, z, length, width, height, yaw = box
    corners = []
    for ahead, left, up in np.ndindex(2, 2, 2):
        forward, sideward = length * (ahead - 0.5), width * (left - 0.5)
        corners.append(
            [
                x + np.cos(yaw) * forward - np.sin(yaw) * sideward,
                y + np.sin(yaw) * forward + np.cos(yaw) * sideward,
                z + height * (up - 0.5),
            ]
        )
    return np.array(corners).reshape(2, 2, 2, 3)


def test_a_2d_box_is_drawn_on_its_four_edges_and_leaves_the_middle(black):
    picture = draw_boxes2d(
        black, Boxes2D(torch.tensor([[100.0, 40.0, 180.0, 90.0]])), ["Car"], tags=False
    )
    color = class_color("Car")
    for row, column in ((40, 140), (90, 140), (65, 100), (65, 180)):
        assert np.abs(picture[row, column].astype(int) - color).max() <= 25  # anti-aliased
    assert (picture[45:86, 105:176] == 0).all()
    assert (picture[:, 190:] == 0).all()


def test_the_given_picture_is_left_as_it_is(black, calibration):
    boxes = Boxes3D(torch.tensor([CAR_AHEAD]))
    draw_boxes2d(black, Boxes2D(torch.tensor([[1.0, 2.0, 30.0, 40.0]])), ["Car"])
    draw_boxes3d(black, boxes, ["Car"], calibration)
    draw_points(black, torch.tensor([[10.0, 0.0, 0.0, 0.5]]), calibration)
    assert (black == 0).all()


def test_a_dont_care_region_has_an_outline_and_no_name(black):
    box = Boxes2D(torch.tensor([[100.0, 60.0, 180.0, 90.0]]))
    named = draw_boxes2d(black, box, ["DontCare"])
    assert (named == draw_boxes2d(black, box, ["DontCare"], tags=False)).all()
    assert named[60, 140].max() > 40


def test_a_score_changes_the_tag(black):
    box = Boxes2D(torch.tensor([[100.0, 60.0, 180.0, 90.0]]))
    low = draw_boxes2d(black, box, ["Car"], scores=torch.tensor([0.11]))
    high = draw_boxes2d(black, box, ["Car"], scores=torch.tensor([0.97]))
    assert (low != high).any()


def test_a_2d_box_far_outside_neither_draws_nor_raises(black):
    boxes = Boxes2D(torch.tensor([[-1e9, -1e9, -1e8, -1e8], [1e9, 10.0, 2e9, 20.0]]))
    assert (draw_boxes2d(black, boxes, ["Car", "Car"], tags=False) == 0).all()


def edges():
    """Pairs of corner indices (ahead, left, up), each of them 0 or 1."""
    for index in np.ndindex(2, 2, 2):
        for axis in range(3):
            if not index[axis]:
                yield index, tuple(1 if k == axis else v for k, v in enumerate(index)), axis


def is_seen(corners, index, axis):
    """Whether the camera, in the origin, lies outside a face that the edge belongs to."""
    for across in {0, 1, 2} - {axis}:
        side = index[across]
        opposite = tuple(1 - side if k == across else v for k, v in enumerate(index))
        outwards = corners[index] - corners[opposite]
        if np.dot(-corners[index], outwards) > 0:
            return True
    return False


@pytest.mark.parametrize("box", [CAR_AHEAD, [9.0, 0.0, 1.2, 4.0, 1.8, 1.5, 1.2]])
def test_edges_of_faces_that_the_camera_sees_are_drawn_and_the_others_are_not(
    black, calibration, box
):
    picture = draw_boxes3d(black, Boxes3D(torch.tensor([box])), ["Car"], calibration, tags=False)
    corners = corners_of(box)
    is_drawn = picture.max(axis=2) > 100
    seen = [edge[:2] for edge in edges() if is_seen(corners, edge[0], edge[2])]
    assert 4 <= len(seen) <= 9
    pixels = [pixels_along(corners, *edge) for edge in seen]
    for row, column in np.concatenate(pixels):
        assert is_drawn[row - 1 : row + 2, column - 1 : column + 2].any()
    hidden = [edge[:2] for edge in edges() if edge[:2] not in seen]
    for row, column in np.concatenate([pixels_along(corners, *edge) for edge in hidden]):
        if np.abs(np.concatenate(pixels) - (row, column)).max(axis=1).min() > 5:
            assert not is_drawn[row, column]


def pixels_along(corners, start, end):
    """Rows and columns of dense points on an edge."""
    shares = np.linspace(0.05, 0.95, 60)
    return np.array([pixel_of((1 - s) * corners[start] + s * corners[end]) for s in shares])


def test_a_farther_box_is_faint_within_a_nearer_one(black, calibration):
    near, far = [8.0, 0.0, 0.0, 2.0, 4.0, 2.0, 0.0], [20.0, 0.0, 0.0, 2.0, 2.0, 1.0, 0.0]
    alone = draw_boxes3d(black, Boxes3D(torch.tensor([far])), ["Car"], calibration, tags=False)
    both = draw_boxes3d(
        black, Boxes3D(torch.tensor([far, near])), ["Car", "Car"], calibration, tags=False
    )
    row, column = pixel_of(np.array([19.0, 1.0, 0.0]))
    before, after = (int(picture[row, column - 1 : column + 2].max()) for picture in (alone, both))
    assert before > 150
    assert after < 0.5 * before


def test_corners_alone_leave_the_middle_of_each_side_free(black):
    box = Boxes2D(torch.tensor([[100.0, 20.0, 200.0, 100.0]]))
    picture = draw_boxes2d(black, box, ["Car"], tags=False, corners_only=True)
    for row, column in ((20, 100), (20, 200), (100, 100), (100, 200)):
        assert picture[row, column].max() > 150
    for row, column in ((20, 150), (100, 150), (60, 100), (60, 200)):
        assert picture[row - 1 : row + 2, column - 1 : column + 2].max() == 0


def test_nothing_is_drawn_outside_the_projected_corners(black, calibration):
    picture = draw_boxes3d(
        black, Boxes3D(torch.tensor([CAR_AHEAD])), ["Car"], calibration, tags=False
    )
    pixels = np.array([pixel_of(corner) for corner in corners_of(CAR_AHEAD).reshape(-1, 3)])
    rows, columns = np.nonzero(picture.max(axis=2))
    assert rows.min() >= pixels[:, 0].min() - 3
    assert rows.max() <= pixels[:, 0].max() + 3
    assert columns.min() >= pixels[:, 1].min() - 3
    assert columns.max() <= pixels[:, 1].max() + 3


def test_the_front_face_is_filled_and_the_rear_is_not(black, calibration):
    away = [10.0, 0.0, 0.0, 4.0, 4.0, 2.0, 0.0]
    facing = [*away[:6], np.pi]
    # Between the smaller far face and the border of the near one only the near face covers.
    row, column = pixel_of(np.array([8.0, 1.65, 0.0]))
    fill = []
    for box in (away, facing):
        picture = draw_boxes3d(
            black, Boxes3D(torch.tensor([box])), ["Car"], calibration, tags=False
        )
        fill.append(int(picture[row, column].max()))
    assert fill[0] == 0
    assert fill[1] > 30


def test_a_box_behind_the_camera_draws_nothing(black, calibration):
    boxes = Boxes3D(torch.tensor([[-10.0, 0.0, 0.0, 4.0, 2.0, 1.5, 0.3]]))
    assert (draw_boxes3d(black, boxes, ["Car"], calibration) == 0).all()


def test_a_box_without_a_size_draws_nothing(black, calibration):
    assert (draw_boxes3d(black, Boxes3D(torch.zeros(2, 7)), ["Car", "Car"], calibration) == 0).all()


def test_a_box_of_nan_is_left_out_beside_others(black, calibration):
    rows = torch.tensor([[torch.nan] * 4, [100.0, 40.0, 180.0, 90.0]])
    alone = draw_boxes2d(black, Boxes2D(rows[1:]), ["Car"])
    assert (draw_boxes2d(black, Boxes2D(rows), ["Pedestrian", "Car"]) == alone).all()
    spaces = torch.tensor([[torch.nan, *CAR_AHEAD[1:]], [torch.nan] * 7, CAR_AHEAD])
    ahead = draw_boxes3d(black, Boxes3D(spaces[2:]), ["Car"], calibration)
    assert (draw_boxes3d(black, Boxes3D(spaces), ["Van", "Van", "Car"], calibration) == ahead).all()


def test_a_box_around_the_camera_is_drawn_ahead_only(black, calibration):
    # A tunnel of 3 x 2 m around the camera, 20 m long: its far end is a rectangle at 10 m.
    boxes = Boxes3D(torch.tensor([[0.0, 0.0, 0.0, 20.0, 3.0, 2.0, 0.0]]))
    picture = draw_boxes3d(black, boxes, ["Car"], calibration, tags=False)
    row, column = pixel_of(np.array([10.0, 1.5, 0.0]))
    assert picture[row, column - 1 : column + 2].max() > 100  # left edge of the far end
    near_row, near_column = pixel_of(np.array([5.0, 1.5, 1.0]))
    assert picture[near_row - 1 : near_row + 2, near_column].max() > 100  # edge that passes by
    assert picture[60, 100].max() == 0  # the side wall: edges only


def test_no_boxes_and_no_points_give_the_picture_back(black, calibration):
    assert (draw_boxes2d(black, Boxes2D(torch.zeros(0, 4)), []) == black).all()
    assert (draw_boxes3d(black, Boxes3D(torch.zeros(0, 7)), [], calibration) == black).all()
    assert (draw_points(black, torch.zeros(0, 4), calibration) == black).all()


def test_a_point_has_the_colour_of_its_range_at_its_pixel(black, calibration):
    point = torch.tensor([[16.0, 12.0, 0.0, 0.5]])  # range 20
    picture = draw_points(black, point, calibration, diameter_px=5.0)
    expected = DEPTH_SCALE.colors(np.array([20.0]))[0]
    row, column = pixel_of(np.array([16.0, 12.0, 0.0]))
    assert np.abs(picture[row, column].astype(int) - expected).max() <= 2
    assert np.count_nonzero(picture.max(axis=2)) < 50


def test_the_nearer_of_two_points_is_on_top(black, calibration):
    points = torch.tensor([[5.0, 0.0, 0.0, 0.5], [50.0, 0.0, 0.0, 0.5]])
    expected = DEPTH_SCALE.colors(np.array([5.0]))[0]
    for order in ([0, 1], [1, 0]):
        picture = draw_points(black, points[order], calibration, diameter_px=5.0)
        assert np.abs(picture[60, 200].astype(int) - expected).max() <= 2


def test_points_behind_the_camera_are_not_drawn(black, calibration):
    points = torch.tensor([[-5.0, 0.0, 0.0, 0.5], [0.0, 0.0, 0.0, 0.5]])
    assert (draw_points(black, points, calibration) == 0).all()


@pytest.mark.parametrize("width", [64, 1242, 3840])
def test_a_box_is_drawn_at_any_picture_size(width):
    picture = np.zeros((width // 4, width, 3), np.uint8)
    box = Boxes2D(torch.tensor([[0.25, 0.25, 0.75, 0.75]]) * torch.tensor([width, width // 4] * 2))
    drawn = draw_boxes2d(picture, box, ["Pedestrian"])
    assert drawn.shape == picture.shape
    assert drawn.dtype == np.uint8
    assert drawn[width // 8, width // 4].max() > 100


def test_boxes_need_a_class_name_each(black, calibration):
    with pytest.raises(ValueError, match="1 boxes cannot be drawn with 2 class names"):
        draw_boxes2d(black, Boxes2D(torch.tensor([[1.0, 2.0, 30.0, 40.0]])), ["Car", "Van"])
    with pytest.raises(ValueError, match="1 boxes cannot be drawn with 0 class names"):
        draw_boxes3d(black, Boxes3D(torch.tensor([CAR_AHEAD])), [], calibration)

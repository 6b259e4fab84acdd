"""Exactness, by properties against a reference of 60 digits, against GEOS and in awkward cases."""

import inspect
import math
from fractions import Fraction

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from sightline.ops import rotated_iou_torch
from sightline.ops.box_rows import box_rows, checked_box_rows, checked_numpy_rows
from sightline.ops.rotated_iou import aligned_iou_3d, pairwise_iou_3d, pairwise_iou_bev
from sightline.ops.rotated_iou_kernel import intersection_area
from tests.reference import rotated_iou as reference

FAR = 1e4  # metres from the origin


def iou_by_kernel(a, b):
    """IoU of two BEV boxes, which must be the same from both entrances and in both orders."""
    first, second = torch.tensor([a], dtype=torch.float64), torch.tensor([b], dtype=torch.float64)
    iou = pairwise_iou_bev(first, second).item()
    assert pairwise_iou_bev(second, first).item() == pytest.approx(iou, abs=1e-9)
    shared = intersection_area(*map(float, a), *map(float, b))
    union = a[2] * a[3] + b[2] * b[3] - shared
    assert (shared / union if union else 0.0) == pytest.approx(iou, abs=1e-15)
    return iou


def iou_by_torch(a, b):
    """IoU by the implementation for other devices."""
    first, second = torch.tensor([a], dtype=torch.float64), torch.tensor([b], dtype=torch.float64)
    return rotated_iou_torch.iou(box_rows(first), box_rows(second)).item()


@pytest.fixture(params=[iou_by_kernel, iou_by_torch])
def iou(request):
    """Implementations to test: kernel and plain PyTorch."""
    return request.param


def moved(box, x, y):
    return (box[0] + x, box[1] + y, *box[2:])


coordinates = st.floats(-4, 4) | st.integers(-4, 4).map(float)
sizes = st.floats(1e-3, 6) | st.integers(1, 6).map(float)
yaws = st.floats(-7, 7) | st.integers(-8, 8).map(lambda eighth: eighth * math.pi / 4)
rectangles = st.tuples(coordinates, coordinates, sizes, sizes, yaws)
boxes = st.tuples(coordinates, coordinates, coordinates, sizes, sizes, sizes, yaws)


@given(a=rectangles, b=rectangles)
def test_both_computations_of_rectangles_equal_exact_arithmetic_and_geos(a, b):
    exact = reference.exact_iou_bev(a, b)
    assert iou_by_kernel(a, b) == pytest.approx(exact, abs=1e-12)
    assert iou_by_torch(a, b) == pytest.approx(exact, abs=1e-12)
    assert reference.shapely_iou_bev(a, b) == pytest.approx(exact, abs=1e-9)


@given(a=st.lists(boxes, max_size=3), b=st.lists(boxes, max_size=3))
def test_both_computations_of_3d_boxes_equal_exact_arithmetic(a, b):
    first = torch.tensor(a, dtype=torch.float64).reshape(-1, 7)
    second = torch.tensor(b, dtype=torch.float64).reshape(-1, 7)
    exact = np.array([[reference.exact_iou_3d(one, other) for other in b] for one in a])
    exact = exact.reshape(len(a), len(b))
    assert pairwise_iou_3d(first, second).numpy() == pytest.approx(exact, abs=1e-12)
    by_torch = rotated_iou_torch.iou(first[:, None], second[None])
    assert by_torch.numpy() == pytest.approx(exact, abs=1e-12)
    count = min(len(a), len(b))
    aligned = aligned_iou_3d(first[:count], second[:count])
    assert aligned.numpy() == pytest.approx(np.diagonal(exact), abs=1e-12)


anything = st.floats(-1e100, 1e100)
any_size = st.floats(0, 1e100)
any_box = st.tuples(anything, anything, anything, any_size, any_size, any_size, anything)


@settings(max_examples=300)
@given(a=any_box, b=any_box)
def test_any_finite_boxes_give_a_number_between_0_and_1(a, b):
    first, second = torch.tensor([a], dtype=torch.float64), torch.tensor([b], dtype=torch.float64)
    for iou in (aligned_iou_3d(first, second), rotated_iou_torch.iou(first, second)):
        assert 0 <= iou.item() <= 1


@given(a=rectangles, b=rectangles, x=coordinates, y=coordinates, turn=yaws)
def test_moving_and_turning_both_boxes_together_changes_nothing(a, b, x, y, turn):
    cos, sin = math.cos(turn), math.sin(turn)

    def carried(box):
        return (
            cos * box[0] - sin * box[1] + x,
            sin * box[0] + cos * box[1] + y,
            *box[2:4],
            box[4] + turn,
        )

    assert iou_by_kernel(carried(a), carried(b)) == pytest.approx(iou_by_kernel(a, b), abs=1e-9)


TRIPLES = ((1, 0, 1), (0, 1, 1), (3, 4, 5), (-5, 12, 13), (8, -15, 17), (-20, -21, 29))
LENGTHS = (Fraction(4), Fraction(1, 2), Fraction(7, 4))


@pytest.mark.parametrize("offset", [0, -3, 10_000])
def test_pairs_with_rational_corners_are_exact_near_and_far(iou, offset):
    pairs = 0
    for cos_a, sin_a, one_a in TRIPLES:
        for cos_b, sin_b, one_b in TRIPLES:
            for length in LENGTHS:
                for dx, dy in ((0, 0), (1, Fraction(1, 2)), (Fraction(-5, 4), 2)):
                    a = (Fraction(offset), Fraction(offset), Fraction(4), Fraction(3, 2))
                    b = (offset + dx, offset - dy, length, Fraction(1))
                    shared = reference.shared_area(
                        reference.rectangle(*a, Fraction(cos_a, one_a), Fraction(sin_a, one_a)),
                        reference.rectangle(*b, Fraction(cos_b, one_b), Fraction(sin_b, one_b)),
                    )
                    exact = shared / (a[2] * a[3] + b[2] * b[3] - shared)
                    box_a = (*map(float, a), math.atan2(sin_a, cos_a))
                    box_b = (*map(float, b), math.atan2(sin_b, cos_b))
                    assert iou(box_a, box_b) == pytest.approx(float(exact), abs=1e-14)
                    pairs += 1
    assert pairs == 324


@pytest.mark.parametrize("yaw", [0.0, 0.1, math.pi / 4, 1.0, math.pi / 2, -math.pi, 3.0])
@pytest.mark.parametrize("center", [(0.0, 0.0), (FAR, -FAR), (FAR + 0.1, 7.3)])
def test_identical_boxes_have_an_iou_of_exactly_1(iou, yaw, center):
    box = (*center, 3.9, 1.6, yaw)
    assert iou(box, box) == 1


@pytest.mark.parametrize("yaw", [0.0, 0.1, math.pi / 4, 1.0, math.pi / 2, -math.pi, 3.0])
@pytest.mark.parametrize("width", [1.6, 3.9, 1e-6])
@pytest.mark.parametrize("quarters", [-4, -3, -2, -1, 1, 2, 3, 4])
def test_the_same_polygon_written_otherwise_has_an_iou_of_1(iou, yaw, width, quarters):
    a = (FAR, -FAR, 3.9, width, yaw)
    sizes = (width, 3.9) if quarters % 2 else (3.9, width)
    b = (FAR, -FAR, *sizes, yaw + quarters * math.pi / 2)
    assert iou(a, b) == pytest.approx(1, abs=1e-9)


@pytest.mark.parametrize("yaw", [0.0, 0.3, math.pi / 4, math.pi / 2])
@pytest.mark.parametrize("offset", [0.0, FAR])
def test_boxes_that_touch_by_an_edge_or_a_corner_share_nothing(iou, yaw, offset):
    a = (offset, offset, 4.0, 2.0, yaw)
    along, across = (math.cos(yaw), math.sin(yaw)), (-math.sin(yaw), math.cos(yaw))
    edge = moved(a, 4 * along[0], 4 * along[1])
    corner = moved(edge, 2 * across[0], 2 * across[1])
    assert iou(a, edge) == pytest.approx(0, abs=1e-12)
    assert iou(a, corner) == pytest.approx(0, abs=1e-12)


def test_upright_boxes_that_touch_have_an_iou_of_exactly_0(iou):
    assert iou((0, 0, 4, 2, 0), (4, 0, 4, 2, 0)) == 0
    assert iou((0, 0, 4, 2, 0), (4, 2, 4, 2, 0)) == 0
    assert iou((0, 0, 4, 2, 0), (0, 2, 4, 2, math.pi)) == pytest.approx(0, abs=1e-15)


@pytest.mark.parametrize("yaw", [0.0, 0.5, math.pi / 4, math.pi / 2, math.pi])
@pytest.mark.parametrize("offset", [0.0, FAR])
def test_a_box_inside_another_has_the_ratio_of_their_areas(iou, yaw, offset):
    outer, inner = (offset, -offset, 8.0, 6.0, 0.2), (offset + 0.5, -offset, 3.0, 1.0, yaw)
    assert iou(outer, inner) == pytest.approx(3 / 48, abs=1e-12)


@pytest.mark.parametrize("sizes", [(0.0, 0.0), (4.0, 0.0), (0.0, 4.0)])
@pytest.mark.parametrize("yaw", [0.0, 0.7, math.pi / 2])
def test_a_box_without_area_has_an_iou_of_exactly_0_with_everything(iou, sizes, yaw):
    empty = (1.0, 2.0, *sizes, yaw)
    assert iou(empty, empty) == 0
    assert iou(empty, (1.0, 2.0, 4.0, 2.0, 0.3)) == 0
    assert iou((1.0, 2.0, 4.0, 2.0, 0.3), empty) == 0


@pytest.mark.parametrize("yaw", [0.0, 0.4, math.pi / 4, math.pi / 2, -2.5])
@pytest.mark.parametrize("offset", [0.0, FAR])
@pytest.mark.parametrize("turn", [0.0, 1e-7, -3e-7, math.pi, math.pi / 2, 1.0])
def test_needles_a_micrometre_wide_are_exact_to_1e_9(iou, yaw, offset, turn):
    a = (offset, offset, 4.0, 1e-6, yaw)
    b = (offset + 0.7 * math.cos(yaw), offset + 0.7 * math.sin(yaw), 4.0, 1e-6, yaw + turn)
    assert iou(a, b) == pytest.approx(reference.exact_iou_bev(a, b), abs=1e-9)


def test_a_needle_through_a_box_shares_its_length_inside(iou):
    assert iou((0, 0, 4, 2, 0), (0, 0, 1e-6, 8, 0)) == pytest.approx(2e-6 / (8 + 6e-6), abs=1e-15)


@pytest.mark.parametrize("yaw", [0.0, 0.3, math.pi / 2])
def test_a_square_turned_by_45_degrees_shares_a_regular_octagon(iou, yaw):
    octagon = 8 * (math.sqrt(2) - 1)  # of a square with sides of 2
    a, b = (FAR, FAR, 2.0, 2.0, yaw), (FAR, FAR, 2.0, 2.0, yaw + math.pi / 4)
    assert iou(a, b) == pytest.approx(octagon / (8 - octagon), abs=1e-12)


@pytest.mark.parametrize(("quarters", "shared"), [(1, 4.0), (2, 8.0), (3, 4.0), (-2, 8.0)])
def test_a_box_turned_by_quarters_shares_a_square_or_all(iou, quarters, shared):
    a, b = (FAR, 5.0, 4.0, 2.0, 0.2), (FAR, 5.0, 4.0, 2.0, 0.2 + quarters * math.pi / 2)
    assert iou(a, b) == pytest.approx(shared / (16 - shared), abs=1e-12)


def test_boxes_above_each_other_share_only_their_common_height():
    lower = torch.tensor([[0.0, 0, 0, 4, 2, 2, 0.3]])
    upper = torch.tensor(
        [[0.0, 0, 1, 4, 2, 2, 0.3], [0, 0, 2, 4, 2, 2, 0.3], [0, 0, 9, 4, 2, 2, 0]]
    )
    assert pairwise_iou_3d(lower, upper).tolist() == [[pytest.approx(1 / 3), 0, 0]]


@given(a=rectangles, b=rectangles, x=st.floats(-FAR, FAR))
def test_float32_boxes_far_away_give_the_iou_of_exactly_those_numbers(a, b, x):
    first, second = torch.tensor([moved(a, x, FAR)]), torch.tensor([moved(b, x, FAR)])
    iou = pairwise_iou_bev(first, second)
    exact = reference.exact_iou_bev(first.double()[0].tolist(), second.double()[0].tolist())
    assert iou.dtype == torch.float32
    assert iou.item() == pytest.approx(exact, abs=1e-6)


def test_the_result_has_the_wider_type_of_the_two():
    half, single, double = (
        torch.ones(1, 7, dtype=t) for t in (torch.half, torch.float, torch.double)
    )
    assert pairwise_iou_3d(half, half).dtype == torch.half
    assert pairwise_iou_3d(half, single).dtype == torch.float
    assert aligned_iou_3d(double, single).dtype == torch.double


@pytest.mark.parametrize(("n", "m"), [(0, 0), (0, 3), (3, 0)])
def test_no_boxes_give_an_empty_result_and_an_empty_gradient(n, m):
    a, b = torch.ones(n, 5, requires_grad=True), torch.ones(m, 7)
    assert pairwise_iou_bev(a, torch.ones(m, 5)).shape == (n, m)
    assert pairwise_iou_3d(torch.ones(n, 7), b).shape == (n, m)
    assert aligned_iou_3d(torch.ones(0, 7), b[:0]).shape == (0,)
    pairwise_iou_bev(a, torch.ones(m, 5)).sum().backward()
    assert torch.equal(a.grad, torch.zeros(n, 5))


def test_columns_of_a_larger_tensor_are_read_as_they_are():
    table = torch.rand(6, 11, dtype=torch.float64)
    view = table[::2, 1:10:2]
    assert torch.equal(pairwise_iou_bev(view, view), pairwise_iou_bev(view.clone(), view.clone()))


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e101])
@pytest.mark.parametrize("column", range(7))
def test_a_value_that_is_no_finite_number_is_refused_with_its_row(value, column):
    boxes = torch.ones(4, 7, dtype=torch.float64)
    boxes[2, column] = value
    with pytest.raises(ValueError, match=r"^boxes_a\[2\] is .* must be finite"):
        pairwise_iou_3d(boxes, torch.ones(1, 7))
    with pytest.raises(ValueError, match=r"^boxes_b\[2\] is .* must be finite"):
        aligned_iou_3d(torch.ones(4, 7), boxes)


@pytest.mark.parametrize("column", [2, 3])
def test_a_negative_size_is_refused_with_its_row(column):
    boxes = torch.ones(3, 5)
    boxes[1, column] = -1e-3
    with pytest.raises(ValueError, match=r"^boxes_a\[1\] .* sizes not negative"):
        pairwise_iou_bev(boxes, boxes)


@pytest.mark.parametrize(("column", "value"), [(0, math.nan), (6, math.inf), (1, -1e101), (5, -1)])
def test_the_check_for_other_devices_refuses_the_same(column, value):
    boxes = torch.ones(4, 7, dtype=torch.float64)
    assert torch.equal(checked_box_rows(boxes, "boxes"), boxes)
    boxes[2, column] = value
    for check in (checked_box_rows, checked_numpy_rows):
        with pytest.raises(ValueError, match=r"^boxes\[2\] is .* must be finite"):
            check(boxes, "boxes")


def test_boxes_of_another_shape_or_type_are_refused():
    # the shape checks of the tests would speak first
    pairwise, aligned = (inspect.unwrap(f) for f in (pairwise_iou_bev, aligned_iou_3d))
    with pytest.raises(ValueError, match=r"boxes_b must be .* 5 values each, got .*\(2, 7\)"):
        pairwise(torch.ones(2, 5), torch.ones(2, 7))
    with pytest.raises(ValueError, match="boxes_a must be a floating-point tensor"):
        pairwise(torch.ones(2, 5, dtype=torch.long), torch.ones(2, 5))
    with pytest.raises(ValueError, match="boxes_a has 2 rows and boxes_b 3"):
        aligned(torch.ones(2, 7), torch.ones(3, 7))

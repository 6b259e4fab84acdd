"""Non-maximum suppression, by kernel and by plain PyTorch, against two loops over lists."""

import inspect
import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.ops.box_rows import checked_box_rows
from sightline.ops.nms import _checked_boxes2d, _suppress_by_torch, nms2d, nms_bev
from tests.reference import nms as reference
from tests.reference.rotated_iou import exact_iou_bev


def suppressed_by_torch(boxes, scores, iou_threshold, labels, max_detections):
    """The path for other devices, on boxes sorted here."""
    order = scores.argsort(descending=True, stable=True)
    rows = _checked_boxes2d(boxes) if boxes.shape[1] == 4 else checked_box_rows(boxes, "boxes")
    kept = _suppress_by_torch(rows[order], labels[order], iou_threshold, max_detections)
    return order[kept].tolist()


def check(function, iou, boxes, scores, labels, iou_threshold, columns):
    expected = reference.nms(boxes, scores, labels, iou, iou_threshold)
    rows = torch.tensor(boxes, dtype=torch.float64).reshape(-1, columns)
    values, classes = torch.tensor(scores), torch.tensor(labels, dtype=torch.long)
    for limit in (0, 2, len(boxes)):
        kept = function(rows, values, iou_threshold, labels=classes, max_detections=limit)
        assert kept.tolist() == expected[:limit]
        by_torch = suppressed_by_torch(rows, values, iou_threshold, classes, limit)
        assert by_torch == expected[:limit]
    assert function(rows, values, iou_threshold, labels=classes).tolist() == expected
    together = reference.nms(boxes, scores, [0] * len(boxes), iou, iou_threshold)
    assert function(rows, values, iou_threshold).tolist() == together


whole = st.integers(0, 5)
corners = st.tuples(whole, whole, whole, whole)
box2d = corners.map(lambda c: (min(c[0], c[2]), min(c[1], c[3]), max(c[0], c[2]), max(c[1], c[3])))
score = st.sampled_from([-1.5, 0.0, 0.25, 0.5, 3.0])  # ties are common
label = st.integers(-1, 1)


@given(
    entries=st.lists(st.tuples(box2d, score, label), max_size=10),
    iou_threshold=st.sampled_from([0.0, 0.25, 0.5, 1.0]),  # IoUs of whole numbers hit them
)
def test_upright_boxes_stay_as_two_loops_say_even_at_ties(entries, iou_threshold):
    boxes, scores, labels = ([entry[k] for entry in entries] for k in range(3))
    check(nms2d, reference.iou2d, boxes, scores, labels, iou_threshold, columns=4)


position, size = st.floats(-3, 3), st.floats(0.5, 4)
rectangle = st.tuples(position, position, size, size, st.floats(-4, 4))


@given(
    entries=st.lists(st.tuples(rectangle, score, label), max_size=6),
    iou_threshold=st.sampled_from([0.0137, 0.31371, 0.7017]),  # no IoU lies within rounding of it
)
def test_rotated_boxes_stay_as_two_loops_say(entries, iou_threshold):
    boxes, scores, labels = ([entry[k] for entry in entries] for k in range(3))
    check(nms_bev, exact_iou_bev, boxes, scores, labels, iou_threshold, columns=5)


def test_an_iou_equal_to_the_threshold_stays_and_a_greater_one_goes():
    boxes, scores = torch.tensor([[0.0, 0, 2, 1], [0, 0, 1, 1]]), torch.tensor([0.9, 0.8])
    assert nms2d(boxes, scores, 0.5).tolist() == [0, 1]
    assert nms2d(boxes, scores, 0.499).tolist() == [0]
    turned = torch.tensor([[0.0, 0, 2, 1, 0], [0, 0, 1, 1, 0]])
    assert nms_bev(turned, scores, 0.5).tolist() == [0, 1]
    assert nms_bev(turned, scores, 0.499).tolist() == [0]


def test_a_box_that_went_suppresses_nothing():
    chain = torch.tensor([[0.0, 0, 4, 4], [0, 2, 4, 6], [0, 4, 4, 8]])
    assert nms2d(chain, torch.tensor([0.9, 0.8, 0.7]), 0.3).tolist() == [0, 2]


def test_of_equal_boxes_with_equal_scores_the_first_stays():
    boxes = torch.tensor([[3.0, 1, 4, 2, 0.3]]).expand(50, 5)
    assert nms_bev(boxes, torch.ones(50), 0.5).tolist() == [0]


def test_boxes_without_area_all_stay():
    points = torch.zeros(3, 4)
    assert nms2d(points, torch.tensor([0.1, 0.3, 0.2]), 0.0).tolist() == [1, 2, 0]
    assert nms_bev(torch.zeros(2, 5), torch.zeros(2), 0.0).tolist() == [0, 1]


def test_infinite_scores_are_ordered_like_any_other():
    boxes = torch.tensor([[0.0, 0, 1, 1], [5, 5, 6, 6], [9, 9, 10, 10]])
    scores = torch.tensor([-math.inf, 0.0, math.inf])
    assert nms2d(boxes, scores, 0.5).tolist() == [2, 1, 0]


def test_boxes_with_a_gradient_are_taken_without_it():
    boxes = torch.tensor([[0.0, 0, 1, 1]], requires_grad=True)
    assert nms2d(boxes, torch.ones(1, requires_grad=True), 0.5).tolist() == [0]


@pytest.mark.parametrize(("function", "columns"), [(nms2d, 4), (nms_bev, 5)])
def test_bad_boxes_scores_and_settings_are_refused_by_name(function, columns):
    boxes, scores = torch.tensor([[0.0, 0, 1, 1, 0]] * 3)[:, :columns], torch.ones(3)
    broken = boxes.clone()
    broken[1, 0] = math.nan
    with pytest.raises(ValueError, match=r"^boxes\[1\] is .* must be finite"):
        function(broken, scores, 0.5)
    broken[1] = torch.tensor([5.0, 5, -1, 6, 0])[:columns]
    with pytest.raises(ValueError, match=r"^boxes\[1\] is .*"):
        function(broken, scores, 0.5)
    with pytest.raises(ValueError, match=r"^scores\[2\] is NaN"):
        function(boxes, torch.tensor([0.1, 0.2, math.nan]), 0.5)
    with pytest.raises(ValueError, match=r"iou_threshold must be between 0 and 1, got 1\.5"):
        function(boxes, scores, 1.5)
    with pytest.raises(ValueError, match="max_detections must not be negative, got -1"):
        function(boxes, scores, 0.5, max_detections=-1)
    # the shape checks of the tests would speak first
    with pytest.raises(ValueError, match=r"scores must hold one value for each of the 3 boxes"):
        inspect.unwrap(function)(boxes, scores[:2], 0.5)
    with pytest.raises(ValueError, match=rf"with {columns} values each, got .*\(3, 3\)"):
        inspect.unwrap(function)(boxes[:, :3], scores, 0.5)
    with pytest.raises(ValueError, match=r"labels must be whole numbers, got torch\.float32"):
        inspect.unwrap(function)(boxes, scores, 0.5, labels=torch.tensor([1.2, 1.7, 1.2]))

"""Gradients of the IoUs: right where there is one, finite everywhere."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.ops.rotated_iou import aligned_iou_3d, pairwise_iou_3d, pairwise_iou_bev


def some_boxes(seed, count):
    """Overlapping boxes in general position, where the IoU is smooth."""
    boxes = torch.randn(count, 7, generator=torch.Generator().manual_seed(seed)).double()
    boxes[:, 3:6] = boxes[:, 3:6].abs() + 1
    return boxes.requires_grad_()


def gradients(function, a, b):
    a, b = a.detach().clone().requires_grad_(), b.detach().clone().requires_grad_()
    function(a, b).sum().backward()
    return a.grad, b.grad


@pytest.mark.parametrize("seed", range(4))
def test_gradients_of_3d_boxes_equal_finite_differences(seed):
    a, b = some_boxes(2 * seed, 6), some_boxes(2 * seed + 1, 6)
    assert (aligned_iou_3d(a, b) > 0).any()
    assert torch.autograd.gradcheck(aligned_iou_3d, (a, b), atol=1e-6)
    assert torch.autograd.gradcheck(pairwise_iou_3d, (a, b[:3]), atol=1e-6)


def test_gradients_of_rectangles_equal_finite_differences():
    columns = [0, 1, 3, 4, 6]
    a, b = some_boxes(8, 6)[:, columns], some_boxes(9, 6)[:, columns]
    assert (pairwise_iou_bev(a, b[:4]) > 0).any()
    assert torch.autograd.gradcheck(pairwise_iou_bev, (a, b[:4]), atol=1e-6)


@pytest.mark.parametrize("yaw", [0.0, 0.3, math.pi / 4, 2.0])
def test_two_identical_boxes_are_at_rest(yaw):
    box = torch.tensor([[10.0, -3, 1, 3.9, 1.6, 1.5, yaw]], dtype=torch.float64)
    for gradient in gradients(aligned_iou_3d, box, box):
        assert gradient.abs().max() < 1e-12


def test_boxes_apart_have_no_gradient():
    a, b = torch.tensor([[0.0, 0, 4, 2, 0.1]]), torch.tensor([[50.0, 0, 4, 2, 0.1]])
    for gradient in gradients(pairwise_iou_bev, a, b):
        assert torch.equal(gradient, torch.zeros(1, 5))


def test_a_gradient_step_brings_overlapping_boxes_closer():
    target = torch.tensor([[0.0, 0, 0, 4, 2, 1.5, 0.3]])
    box = torch.tensor([[0.6, -0.3, 0.2, 3.5, 2.2, 1.4, 0.5]], requires_grad=True)
    before = aligned_iou_3d(box, target)
    before.sum().backward()
    with torch.no_grad():
        after = aligned_iou_3d(box + 0.05 * box.grad, target)
    assert after.item() > before.item() + 0.01


whole = st.integers(-2, 2).map(float)
size = st.sampled_from([0.0, 1e-6, 1.0, 2.0])
eighth_turns = st.integers(-4, 4).map(lambda eighth: eighth * math.pi / 4)
awkward = st.tuples(whole, whole, whole, size, size, size, eighth_turns)


@given(a=awkward, b=awkward)
def test_gradients_are_finite_where_boxes_touch_coincide_or_vanish(a, b):
    first, second = torch.tensor([a], dtype=torch.float64), torch.tensor([b], dtype=torch.float64)
    for gradient in gradients(aligned_iou_3d, first, second):
        assert gradient.isfinite().all()


def test_float32_boxes_get_a_float32_gradient():
    a, b = some_boxes(1, 3).float(), some_boxes(2, 3)
    by_a, by_b = gradients(pairwise_iou_3d, a, b)
    assert (by_a.dtype, by_b.dtype) == (torch.float32, torch.float64)


def test_a_box_without_area_inside_another_is_told_to_grow():
    flat, target = torch.tensor([[0.2, 0, 2, 0, 0.1]]), torch.tensor([[0.0, 0, 4, 2, 0]])
    by_flat, _ = gradients(pairwise_iou_bev, flat, target)
    assert by_flat[0, 3].item() == pytest.approx(2 / 8)  # its length over the area of the other

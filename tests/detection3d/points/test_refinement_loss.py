"""Both losses of the second stage against loops over numbers."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.detection3d.points.config import RefinementLossConfig
from sightline.detection3d.points.refinement_training import box_loss, confidence_loss
from tests.reference import proposals as reference

CONFIG = RefinementLossConfig()
number = st.floats(-5, 5)
box = st.lists(number, min_size=7, max_size=7)
iou = st.sampled_from([0.0, 0.2, 0.45, 0.5, 0.55, 0.6, 0.9, 1.0])  # the limits themselves
samples = st.lists(st.tuples(box, box, iou, number), max_size=6)


def columns(entries):
    predicted, target, ious, logits = ([entry[k] for entry in entries] for k in range(4))
    shape = (-1, 7)
    return (
        torch.tensor(predicted, dtype=torch.float64).reshape(shape),
        torch.tensor(target, dtype=torch.float64).reshape(shape),
        torch.tensor(ious, dtype=torch.float64),
        torch.tensor(logits, dtype=torch.float64),
    )


@given(entries=samples)
def test_boxes_of_foreground_count_part_by_part(entries):
    predicted, target, ious, _ = columns(entries)
    expected = reference.box_loss(predicted.tolist(), target.tolist(), ious.tolist())
    assert [loss.item() for loss in box_loss(predicted, target, ious, CONFIG)] == pytest.approx(
        expected
    )


@given(entries=samples)
def test_confidence_counts_where_the_overlap_is_clear(entries):
    _, _, ious, logits = columns(entries)
    scores = [1 / (1 + math.exp(-logit)) for logit in logits.tolist()]
    expected = reference.confidence_loss(scores, ious.tolist())
    assert confidence_loss(logits, ious, CONFIG).item() == pytest.approx(expected)


@pytest.mark.parametrize("count", [0, 3])
def test_without_anything_that_counts_both_are_0_and_so_is_their_gradient(count):
    predicted = torch.randn(count, 7, requires_grad=True)
    logits = torch.randn(count, requires_grad=True)
    between = torch.full((count,), 0.5)
    total = box_loss(predicted, torch.randn(count, 7), between, CONFIG).total
    total = total + confidence_loss(logits, between, CONFIG)
    total.backward()
    assert total.item() == 0
    assert torch.equal(predicted.grad, torch.zeros(count, 7))
    assert torch.equal(logits.grad, torch.zeros(count))


def test_an_absurdly_sure_error_costs_a_finite_number():
    loss = confidence_loss(torch.tensor([-500.0, 500.0]), torch.tensor([1.0, 0.0]), CONFIG)
    assert loss.item() == 500


def test_settings_out_of_range_are_refused():
    with pytest.raises(ValueError, match="negative_iou must be below positive_iou"):
        RefinementLossConfig(negative_iou=0.6)
    with pytest.raises(ValueError, match="foreground_iou must be from 0 to 1, got 2"):
        RefinementLossConfig(foreground_iou=2.0)
    with pytest.raises(ValueError, match="size_weight must be finite and not negative, got -1"):
        RefinementLossConfig(size_weight=-1.0)

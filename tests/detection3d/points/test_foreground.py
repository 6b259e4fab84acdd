"""Points on objects and the focal loss, against loops."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.detection3d.points.config import FocalLossConfig
from sightline.detection3d.points.proposal_training import (
    BACKGROUND,
    IGNORED,
    focal_loss,
    point_targets,
)
from tests.detection3d.boxes import car
from tests.ops.clouds import street
from tests.reference import box_coding as reference
from tests.reference import point_ops


def test_points_have_the_class_of_their_object_and_are_ignored_close_around_it():
    cloud = street(0, 2000)
    boxes = torch.tensor([[car(9.0, 1.0, 0.4), car(12.0, 0.5, 1.2), car(30.0), [0.0] * 7]])
    classes = torch.tensor([[2, 0, 1, 0]])
    targets = point_targets(cloud, boxes, classes)
    seen = set()
    for point, point_class, box in zip(
        cloud[0].tolist(), targets.point_class[0].tolist(), targets.box[0].tolist(), strict=True
    ):
        depths = [point_ops.depth_in_box(point, entry) for entry in boxes[0, :3].tolist()]
        inside = [k for k, depth in enumerate(depths) if depth >= 0]
        assert box == (inside[0] if inside else -1)
        if inside:
            expected = classes[0, inside[0]].item()
        else:
            expected = IGNORED if max(depths) >= -0.2 else BACKGROUND
        assert point_class == expected
        seen.add(point_class)
    assert seen == {BACKGROUND, IGNORED, 0, 1, 2}


def test_the_margin_does_not_bring_back_rows_of_zeros():
    targets = point_targets(torch.zeros(1, 1, 3), torch.zeros(1, 2, 7), torch.zeros(1, 2).long())
    assert targets.point_class.tolist() == [[BACKGROUND]]


@pytest.mark.parametrize(("num_points", "num_boxes"), [(0, 0), (0, 2), (3, 0)])
def test_no_points_or_no_objects_are_no_fault(num_points, num_boxes):
    classes = torch.zeros(2, num_boxes, dtype=torch.int64)
    targets = point_targets(torch.zeros(2, num_points, 3), torch.ones(2, num_boxes, 7), classes)
    assert targets.point_class.tolist() == [[BACKGROUND] * num_points] * 2


@given(
    entries=st.lists(
        st.tuples(
            st.lists(st.floats(-20, 20), min_size=2, max_size=2),
            st.sampled_from([IGNORED, BACKGROUND, 0, 1]),
        ),
        max_size=6,
    ),
    alpha=st.sampled_from([0.25, 0.9]),
    gamma=st.sampled_from([0.0, 0.5, 1.5, 2.0]),
)
def test_the_focal_loss_is_its_equation_over_the_points_on_objects(entries, alpha, gamma):
    total = sum(
        reference.focal(logit, point_class == k, alpha, gamma)
        for logits, point_class in entries
        if point_class != IGNORED
        for k, logit in enumerate(logits)
    )
    on_objects = sum(point_class >= 0 for _, point_class in entries)
    logits = torch.tensor([entry[0] for entry in entries], dtype=torch.float64).reshape(-1, 2)
    classes = torch.tensor([entry[1] for entry in entries], dtype=torch.int64)
    loss = focal_loss(logits, classes, FocalLossConfig(alpha=alpha, gamma=gamma))
    assert loss.item() == pytest.approx(total / max(on_objects, 1), rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("gamma", [0.0, 0.5, 2.0])
def test_ignored_points_have_no_gradient_and_sure_errors_a_finite_one(gamma):
    logits = torch.tensor([[-300.0], [300.0], [1.0], [300.0], [-300.0]], requires_grad=True)
    classes = torch.tensor([0, BACKGROUND, IGNORED, 0, BACKGROUND])
    focal_loss(logits, classes, FocalLossConfig(gamma=gamma)).backward()
    assert logits.grad.isfinite().all()
    assert logits.grad[2].item() == 0
    assert logits.grad[0].item() < 0 < logits.grad[1].item()


def test_settings_out_of_range_are_refused():
    with pytest.raises(ValueError, match="alpha must be from 0 to 1, got 2"):
        FocalLossConfig(alpha=2.0)
    with pytest.raises(ValueError, match="gamma must be finite and not negative, got inf"):
        FocalLossConfig(gamma=math.inf)

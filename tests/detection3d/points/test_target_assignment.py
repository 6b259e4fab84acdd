"""Objects of proposals, against exact overlaps."""

import pytest
import torch
from hypothesis import given

from sightline.detection3d.points.refinement_training import NO_TRUTH, assign_truths
from sightline.ops.rotated_iou import pairwise_iou_3d
from tests.detection3d.boxes import car, near_boxes, rows
from tests.reference import proposals as reference


def assigned(proposals, truths):
    return assign_truths(pairwise_iou_3d(proposals, truths), truths)


@given(proposals=near_boxes, truths=near_boxes)
def test_each_proposal_takes_an_object_of_highest_overlap(proposals, truths):
    assignment = assigned(rows(proposals), rows(truths))
    expected = reference.assigned(proposals, truths)
    assert assignment.iou.tolist() == pytest.approx([iou for _, iou in expected], abs=1e-12)
    for k, proposal in enumerate(proposals if truths else []):
        chosen = truths[assignment.truth[k]]
        assert reference.upright_iou(proposal, chosen) == pytest.approx(expected[k][1], abs=1e-12)
        assert torch.equal(assignment.boxes[k], rows([chosen])[0])


def test_of_objects_that_overlap_equally_the_first_is_taken():
    assignment = assigned(rows([car(0.0)]), rows([car(1.0), car(0.5), car(0.5)]))
    assert assignment.truth.tolist() == [1]


def test_without_objects_there_is_nothing_to_become():
    assignment = assigned(rows([car(0.0), car(3.0)]), rows([]))
    assert assignment.truth.tolist() == [NO_TRUTH] * 2
    assert assignment.iou.tolist() == [0, 0]
    assert torch.equal(assignment.boxes, torch.zeros(2, 7, dtype=torch.float64))


def test_a_proposal_on_nothing_takes_the_first_object_with_an_iou_of_0():
    assignment = assigned(rows([car(90.0)]), rows([car(0.0), car(5.0)]))
    assert (assignment.truth.item(), assignment.iou.item()) == (0, 0)


def test_without_proposals_there_is_no_assignment():
    assert assigned(rows([]), rows([car(0.0)])).boxes.shape == (0, 7)

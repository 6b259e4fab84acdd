"""Recall of proposals against exact overlaps."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.detection3d.proposal_recall import ProposalRecall, find_recalled
from tests.detection3d.boxes import car, near_boxes, rows
from tests.reference.proposals import upright_iou


@given(proposals=near_boxes, truths=near_boxes, min_iou=st.sampled_from([0.3, 0.5, 0.7, 1.0]))
def test_an_object_is_found_if_any_proposal_overlaps_it_enough(proposals, truths, min_iou):
    expected = [
        any(upright_iou(proposal, truth) >= min_iou for proposal in proposals) for truth in truths
    ]
    assert find_recalled(rows(proposals), rows(truths), min_iou=min_iou).tolist() == expected


def test_one_proposal_may_find_several_objects_and_the_limit_is_enough():
    apart = [car(0.0), car(4.0), car(20.0)]
    over_both = [2.0, 0.0, 0.0, 8.0, 2.0, 1.5, 0.0]  # twice as long: IoU 1/2 with each
    assert find_recalled(rows([over_both]), rows(apart)).tolist() == [True, True, False]


def test_frames_are_averaged_with_and_without_those_that_have_no_object():
    recall = ProposalRecall(num_found=(1, 3, 0), num_truths=(2, 3, 0))
    assert recall.recall == pytest.approx(4 / 5)
    assert recall.recall_frames_with_objects == pytest.approx(3 / 4)
    assert recall.recall_all_frames == pytest.approx(1 / 2)


def test_no_frames_and_no_objects_have_a_recall_of_0():
    for recall in (
        ProposalRecall(num_found=(), num_truths=()),
        ProposalRecall(num_found=(0,), num_truths=(0,)),
    ):
        assert recall.recall == 0
        assert recall.recall_frames_with_objects == 0
        assert recall.recall_all_frames == 0


def test_impossible_counts_and_overlaps_are_refused():
    with pytest.raises(ValueError, match="cannot have more objects found than objects"):
        ProposalRecall(num_found=(2,), num_truths=(1,))
    for min_iou in (0.0, 1.1):
        with pytest.raises(ValueError, match="min_iou must be above 0 and at most 1"):
            find_recalled(torch.zeros(0, 7), torch.zeros(0, 7), min_iou=min_iou)

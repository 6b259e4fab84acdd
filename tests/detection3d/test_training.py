"""Recall over frames against exact overlaps and counting by hand."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.detection3d.training import ProposalRecallMetric, find_recalled
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


def test_an_iou_out_of_range_is_refused():
    for min_iou in (0.0, 1.1):
        with pytest.raises(ValueError, match="min_iou must be above 0 and at most 1"):
            find_recalled(torch.zeros(0, 7), torch.zeros(0, 7), min_iou=min_iou)


def test_recall_is_of_all_objects_and_a_mean_of_frames_in_which_one_without_objects_counts_0():
    frames = [
        (rows([car(10), car(30)]), rows([car(10), car(30.5), car(50)])),
        (rows([]), rows([car(5)])),
        (rows([car(9)]), rows([])),
    ]
    metric = ProposalRecallMetric()
    metric.update([frames[0][0]], [frames[0][1]])
    metric.update([each[0] for each in frames[1:]], [each[1] for each in frames[1:]])
    scores = {name: float(value) for name, value in metric.compute().items()}
    assert scores["recall/0.5"] == pytest.approx(100 * 2 / 4)
    assert scores["recall/0.5_frames"] == pytest.approx(100 * (2 / 3 + 0 + 0) / 3)
    assert scores["recall/0.7"] == pytest.approx(100 * 2 / 4)
    assert scores["recall/0.7_frames"] == pytest.approx(100 * (2 / 3 + 0 + 0) / 3)


def test_without_frames_recall_is_0():
    metric = ProposalRecallMetric()
    metric.update([], [])
    assert set(map(float, metric.compute().values())) == {0.0}

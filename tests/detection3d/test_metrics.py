"""Recall over frames against counting by hand."""

import pytest

from sightline.detection3d.metrics import ProposalRecallMetric
from sightline.detection3d.proposal_recall import ProposalRecall, find_recalled
from tests.detection3d.boxes import car, rows


def test_recall_is_that_of_all_frames_however_they_are_given():
    frames = [
        (rows([car(10), car(30)]), rows([car(10), car(30.5), car(50)])),
        (rows([]), rows([car(5)])),
        (rows([car(9)]), rows([])),
    ]
    metric = ProposalRecallMetric()
    metric.update([frames[0][0]], [frames[0][1]])
    metric.update([each[0] for each in frames[1:]], [each[1] for each in frames[1:]])
    scores = metric.compute()
    for iou in (0.5, 0.7):
        found = tuple(int(find_recalled(*each, min_iou=iou).sum()) for each in frames)
        expected = ProposalRecall(num_found=found, num_truths=(3, 1, 0))
        assert float(scores[f"recall/{iou}"]) == pytest.approx(100 * expected.recall)
        frames_mean = 100 * expected.recall_all_frames
        assert float(scores[f"recall/{iou}_frames"]) == pytest.approx(frames_mean)

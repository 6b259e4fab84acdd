"""Selection of the refined boxes that stay."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.detection3d.suppression import SuppressionConfig, suppress_boxes
from tests.detection3d.boxes import car, near, rows
from tests.reference.proposals import upright_iou

score = st.sampled_from([0.0, 0.29, 0.3, 0.5, 0.9])


@given(entries=st.lists(st.tuples(near, score), max_size=8))
def test_the_surest_stay_and_what_overlaps_them_from_above_goes(entries):
    boxes, scores = [entry[0] for entry in entries], [entry[1] for entry in entries]
    waiting = sorted((-s, k) for k, s in enumerate(scores) if s >= 0.3)
    kept = []
    while waiting:  # the algorithm of the textbook
        best = waiting.pop(0)[1]
        kept.append(best)
        waiting = [
            entry
            for entry in waiting
            if upright_iou(boxes[best], boxes[entry[1]]) < 0.1  # all are of one height
        ]
    given_scores, config = torch.tensor(scores).double(), SuppressionConfig(min_score=0.3)
    assert suppress_boxes(rows(boxes), given_scores, config).tolist() == kept


def test_an_overlap_that_equals_the_limit_goes():
    apart = rows([car(0.0), car(2.0)])  # half of each: IoU 1/3
    scores = torch.tensor([0.5, 0.9])
    assert suppress_boxes(apart, scores, SuppressionConfig(iou=2 / 6)).tolist() == [1]
    just_above = math.nextafter(2 / 6, 1)
    assert suppress_boxes(apart, scores, SuppressionConfig(iou=just_above)).tolist() == [1, 0]


def test_height_saves_no_copy_but_another_label_does():
    pair = rows([car(0.0), car(0.0)])
    pair[1, 2] = 5.0
    scores = torch.tensor([0.5, 0.5])
    assert suppress_boxes(pair, scores).tolist() == [0]
    assert suppress_boxes(pair, scores, labels=torch.tensor([0, 1])).tolist() == [0, 1]


def test_nothing_stays_nothing_and_nan_is_refused():
    assert suppress_boxes(rows([]), torch.zeros(0)).tolist() == []
    with pytest.raises(ValueError, match="is NaN"):
        suppress_boxes(rows([car(0.0)]), torch.tensor([math.nan]))
    with pytest.raises(ValueError, match="min_score must be from 0 to 1, got 2"):
        SuppressionConfig(min_score=2.0)
    with pytest.raises(ValueError, match="iou must be above 0 and at most 1, got 0"):
        SuppressionConfig(iou=0.0)

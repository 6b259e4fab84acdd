"""Figures of the proposals of frames, from boxes whose overlaps are plain."""

import pytest
import torch

from benchmarks.proposal_sampling import Frame, _offered, _recall, _suppressed
from sightline.detection3d.stages import Proposed
from sightline.detection3d.sweeps import SweepTruth

CAR = (20.0, 0.0, -1.0, 4.0, 2.0, 1.5, 0.0)


def shifted(along_m, up_m=0.0):
    return [CAR[0] + along_m, CAR[1], CAR[2] + up_m, *CAR[3:]]


def frame(shifts, *, truths=(CAR,)):
    """Proposals moved along one car of 4 m: a shift of s metres has an IoU of (4 - s) / (4 + s)."""
    boxes = torch.tensor([shifted(*each) for each in shifts])
    scores = torch.linspace(0.9, 0.4, len(shifts))
    return Frame(
        sweep=torch.zeros(0, 4),
        proposed=Proposed(boxes, torch.zeros(len(shifts), dtype=torch.int64), scores),
        truth=SweepTruth(
            boxes=torch.tensor(truths, dtype=torch.float64).reshape(-1, 7),
            classes=torch.zeros(len(truths), dtype=torch.int64),
            ignored_boxes=torch.zeros(0, 7, dtype=torch.float64),
            ignored_classes=torch.zeros(0, 1, dtype=torch.bool),
        ),
    )


def test_proposals_are_counted_by_their_iou_and_drawn_by_their_share():
    moved = [(0.0,), (1.0,), (1.25,), (2.0,), (9.0,), (12.0,), (15.0,), (18.0,)]
    found = _offered([frame(moved)])  # IoU 1, 0.6, 0.52, 0.33, 0 and so on
    assert found["foreground, IoU 0.55 or more"] == 2
    assert found["between 0.45 and 0.55"] == 1
    assert found["hard background, 0.05 to 0.45"] == 1
    assert found["easy background, below 0.05"] == 4
    assert found["as asked: foreground of 64"] == 2
    assert found["as asked: hard of 64"] == 31
    assert found["(1) foreground of 64"] == 16
    assert found["(2) repeats of a hard one"] == 62
    assert found["(3) proposals within 0.05 of the limit 0.5"] == 1
    assert found["(3) the same, of those at 0.5 or more, %"] == pytest.approx(100 / 3)
    assert found["objects with a foreground proposal, %"] == 100
    assert found["frames without foreground, %"] == 0


def test_cars_whose_best_proposal_is_no_foreground_are_told():
    found = _offered([frame([(2.0,), (9.0,)]), frame([(9.0,)], truths=())])
    assert found["objects with a best proposal from 0 to 0.55, %"] == 100
    assert found["frames without foreground, %"] == 100
    assert found["frames without hard background, %"] == 50


def test_recall_counts_the_surest_proposals_alone():
    late = [(9.0 + 5 * number,) for number in range(10)] + [(0.0,)]
    found = _recall([frame(late)])
    assert found["recall at 0.5, 10 proposals, %"] == 0
    assert found["recall at 0.5, 20 proposals, %"] == 100
    assert found["proposals on an object, of 20, %"] == pytest.approx(100 / 11)


def test_a_duplicate_at_another_height_stays_where_the_overlap_is_in_3d():
    found = _suppressed([frame([(0.0, 0.0), (0.0, 1.4), (0.5, 0.0)])])
    assert found["boxes after suppression from above"] == 1
    assert found["boxes after suppression in 3D"] == 2
    assert found["pairs of objects with 0.1 or more from above"] == 0

"""Which boxes become proposals, against loops over lists."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.detection3d.points.config import ProposalConfig
from sightline.detection3d.points.proposals import choose_proposals
from tests.detection3d.boxes import car, rows
from tests.reference.nms import nms
from tests.reference.proposals import upright_iou

at = st.tuples(st.integers(-3, 3).map(lambda k: k + 0.0), st.sampled_from([0.0, 38.0, 41.0, 60.0]))
entry = st.tuples(at, st.sampled_from([-1.0, 0.0, 0.5, 2.0]))


@given(
    entries=st.lists(entry, max_size=12),
    num_proposals=st.integers(1, 6),
    num_candidates=st.integers(6, 9),
    near_share=st.sampled_from([0.0, 0.5, 0.7, 1.0]),
)
def test_near_and_far_boxes_have_shares_of_their_own(
    entries, num_proposals, num_candidates, near_share
):
    boxes, scores = [car(x, y) for (x, y), _ in entries], [score for _, score in entries]
    config = ProposalConfig(
        num_proposals=num_proposals,
        num_candidates=num_candidates,
        iou=0.3,
        near_share=near_share,
    )
    near = [k for k, box in enumerate(boxes) if math.hypot(box[0], box[1]) <= 40]
    far = [k for k in range(len(boxes)) if k not in near]
    shares = {True: (num_candidates, num_proposals), False: (0, 0)}
    if near and far:
        shares[True] = round(near_share * num_candidates), round(near_share * num_proposals)
        shares[False] = num_candidates - shares[True][0], num_proposals - shares[True][1]
    elif far:
        shares = {True: (0, 0), False: shares[True]}
    expected = []
    for places, (candidates, proposals) in ((near, shares[True]), (far, shares[False])):
        best = sorted(places, key=lambda k: (-scores[k], k))[:candidates]
        kept = nms(
            [boxes[k] for k in best], [scores[k] for k in best], [0] * len(best), upright_iou, 0.3
        )
        expected += [best[k] for k in kept[:proposals]]
    assert choose_proposals(rows(boxes), torch.tensor(scores), config).tolist() == expected


def test_published_numbers_are_the_defaults():
    assert (ProposalConfig().num_proposals, ProposalConfig().iou) == (100, 0.8)
    spread = rows([car(0.0, 9.0 * k - 3000) for k in range(600)])
    assert (
        len(choose_proposals(spread, torch.rand(600), ProposalConfig())) == 39
    )  # 9 near ones, and 30 of the far


def test_what_is_out_of_range_is_refused():
    with pytest.raises(ValueError, match="must be from 1 to num_candidates 9, got 10"):
        ProposalConfig(num_candidates=9, num_proposals=10)
    with pytest.raises(ValueError, match="num_candidates must be up to 33554432, got 100 times 1"):
        ProposalConfig(num_candidates=10**6)
    with pytest.raises(ValueError, match="iou must be from 0 to 1, got -1"):
        ProposalConfig(iou=-1.0)
    with pytest.raises(ValueError, match="near_m must be positive and finite, got inf"):
        ProposalConfig(near_m=math.inf)
    with pytest.raises(ValueError, match="near_share must be from 0 to 1, got 2"):
        ProposalConfig(near_share=2.0)

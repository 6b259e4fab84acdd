"""Boxes encoded as changes of a proposal: against plain numbers, and there and back."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.detection3d.pillars.boxes import decode_regions, encode_regions, keeps_front
from tests.reference import compact3d as reference

number, size = st.floats(-20, 20), st.floats(1.0, 2.0)
box = st.tuples(number, number, number, size, size, size, st.floats(-3.1, 3.1))


def exact(*rows):
    return torch.tensor(rows, dtype=torch.float64)


@given(truth=box, proposal=box)
def test_a_box_is_told_in_the_frame_of_its_proposal_and_comes_back(truth, proposal):
    boxes, proposals = exact(truth), exact(proposal)
    values = encode_regions(boxes, proposals)
    assert values[0].tolist() == pytest.approx(reference.region_values(truth, proposal), abs=1e-9)
    back = decode_regions(values, keeps_front(boxes, proposals), proposals)
    torch.testing.assert_close(back[:, :6], boxes[:, :6], atol=1e-9, rtol=0)
    half_turn = abs(math.cos(truth[6] - proposal[6])) < 1e-6  # either end is as near
    assert math.cos(back[0, 6].item() - truth[6]) == pytest.approx(1) or half_turn


@given(truth=box, proposal=box, turn=number, move=st.tuples(number, number))
def test_the_code_is_the_same_wherever_the_two_stand_and_however_yaws_are_wrapped(
    truth, proposal, turn, move
):
    together = []
    for each in (truth, proposal):
        x = math.cos(turn) * each[0] - math.sin(turn) * each[1] + move[0]
        y = math.sin(turn) * each[0] + math.cos(turn) * each[1] + move[1]
        together.append(exact((x, y, *each[2:6], each[6] + turn + 2 * math.pi)))
    torch.testing.assert_close(
        encode_regions(*together), encode_regions(exact(truth), exact(proposal)), atol=1e-8, rtol=0
    )


def test_zeros_leave_a_proposal_as_it_is_and_another_front_turns_it():
    proposal = exact((3, -2, 0.5, 4, 1.6, 1.5, 1.0))
    nothing = torch.zeros(1, 8, dtype=torch.float64)
    torch.testing.assert_close(decode_regions(nothing, torch.tensor([True]), proposal), proposal)
    turned = decode_regions(nothing, torch.tensor([False]), proposal)
    assert turned[0, 6].item() == pytest.approx(1 - math.pi)


def test_a_size_changes_by_no_more_than_a_bound():
    values = exact((0, 0, 0, 99, -99, 0, 0, 0))
    changed = decode_regions(values, torch.tensor([True]), exact((0, 0, 0, 1, 1, 1, 0)))
    assert changed[0, 3:6].tolist() == pytest.approx([math.exp(0.75), math.exp(-0.75), 1])

"""Boxes encoded by cells: against plain numbers, and there and back."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.detection3d.pillars.boxes import (
    CENTER_VALUES,
    FRONT,
    cell_middles,
    decode_centers,
    encode_centers,
)
from sightline.detection3d.pillars.config import PillarGridConfig
from tests.reference import compact3d as reference

MEAN = (3.88, 1.63, 1.53)
number = st.floats(-30, 30)
size = st.floats(0.7, 1.4)
box = st.tuples(number, number, st.floats(-3, 1), size, size, size, st.floats(-3.1, 3.1)).map(
    lambda b: (*b[:3], *(factor * mean for factor, mean in zip(b[3:6], MEAN, strict=True)), b[6])
)


def exact(rows):
    return torch.tensor(rows, dtype=torch.float64)


@given(box=box, x=number, y=number)
def test_a_cell_tells_the_numbers_of_the_box_and_they_give_the_box_back(box, x, y):
    rows, mean, middles = exact([box]), exact([MEAN]), exact([[x, y]])
    code = encode_centers(rows, middles, mean)
    assert code[0].tolist() == pytest.approx(reference.center_values(box, x, y, MEAN), abs=1e-9)
    values = torch.cat((code, torch.zeros(1, 1)), dim=1)
    assert values.shape[1] == CENTER_VALUES
    torch.testing.assert_close(decode_centers(values, middles, mean), rows)


@given(yaw=st.floats(-3.1, 3.1), doubt=st.floats(0.01, 10))
def test_an_unsure_front_costs_nothing_of_the_axis(yaw, doubt):
    mean, middles, box = exact([MEAN]), exact([[0, 0]]), exact([[0, 0, 0, 4, 2, 1.5, yaw]])
    values = torch.cat((encode_centers(box, middles, mean), torch.zeros(1, 1)), dim=1)
    values[:, FRONT] *= doubt  # low or high confidence: the same end
    decoded = decode_centers(values, middles, mean)[0, 6].item()
    assert math.cos(decoded - yaw) == pytest.approx(1)
    values[:, FRONT] *= -1
    backwards = decode_centers(values, middles, mean)[0, 6].item()
    assert math.cos(backwards - yaw) == pytest.approx(-1)


def test_sizes_far_off_the_mean_are_held():
    values = torch.zeros(1, CENTER_VALUES)
    values[0, 3], values[0, 4] = 9, -9
    box = decode_centers(values, torch.zeros(1, 2), torch.ones(1, 3))
    assert box[0, 3:6].tolist() == pytest.approx([math.e, 1 / math.e, 1])


def test_middles_lie_half_a_cell_behind_the_lower_borders():
    cells = torch.tensor([[0, 0], [2, 1]])
    middles = cell_middles(cells, PillarGridConfig())
    assert middles.flatten().tolist() == pytest.approx([0.2, -39.8, 1.0, -39.4], abs=1e-5)

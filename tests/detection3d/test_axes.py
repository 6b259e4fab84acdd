"""Proposals refined from several axes: each axis once, and the best-scored box of each proposal."""

import math
from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.detection3d.config import HeadingHypothesesConfig
from sightline.detection3d.detector import (
    Detector3D,
    TurnedProposals,
    best_headings,
    propose,
    refine,
    turn_to_axes,
)
from sightline.detection3d.pillars.regions import RegionOutput
from sightline.detection3d.stages import Proposed
from sightline.detection3d.sweeps import network_sweep
from tests.detection3d.frames import COMPACT, simulated_frames
from tests.reference.axes import reference_surest

seeds = st.integers(0, 10**6)


def some_proposals(seed, count):
    drawn = torch.rand(count, 7, generator=torch.Generator().manual_seed(seed))
    boxes = torch.cat((drawn[:, :6] + 1, math.tau * drawn[:, 6:] - math.pi), dim=1)
    return Proposed(boxes, torch.arange(count) % 3, drawn[:, 0])


@given(seed=seeds, count=st.integers(0, 6), number=st.integers(2, 5))
def test_all_stand_first_as_they_are_and_then_some_with_each_other_axis(seed, count, number):
    proposed = some_proposals(seed, count)
    is_turned = proposed.classes == 1
    turned = turn_to_axes(proposed, is_turned, number)
    assert torch.equal(turned.proposed.boxes[:count], proposed.boxes)
    assert torch.equal(turned.proposed.boxes[:, :6], proposed.boxes[turned.origins, :6])
    assert torch.equal(turned.proposed.classes, proposed.classes[turned.origins])
    assert torch.equal(turned.proposed.scores, proposed.scores[turned.origins])
    for place in range(count):
        mine = turned.origins == place
        yaw = turned.proposed.boxes[mine, 6] - proposed.boxes[place, 6]
        expected = torch.arange(number if is_turned[place] else 1) * math.pi / number
        torch.testing.assert_close((2 * yaw).cos(), (2 * expected).cos(), atol=1e-5, rtol=0)
        torch.testing.assert_close((2 * yaw).sin(), (2 * expected).sin(), atol=1e-5, rtol=0)


@given(seed=seeds, count=st.integers(1, 6), number=st.integers(2, 5))
def test_the_surest_axis_is_taken_if_it_gains_enough(seed, count, number):
    proposed = some_proposals(seed, count)
    turned = turn_to_axes(proposed, proposed.classes != 2, number)
    scores = torch.rand(len(turned.origins), generator=torch.Generator().manual_seed(seed + 1))
    config = HeadingHypothesesConfig(number=number, least_gain=0.2)
    found = best_headings(scores, turned, config)
    assert found.tolist() == reference_surest(scores, turned, config.least_gain)


def test_a_gain_that_is_too_small_leaves_the_proposal_s_own_axis():
    turned = TurnedProposals(some_proposals(0, 2), torch.tensor([0, 0]), torch.tensor([0, 1]))
    scores = torch.tensor([0.5, 0.504])
    assert best_headings(scores, turned, HeadingHypothesesConfig(least_gain=0.01)).tolist() == [0]
    assert best_headings(scores, turned, HeadingHypothesesConfig(least_gain=0.005)).tolist() == [1]


class _PrefersBoxesAlongX(torch.nn.Module):
    """Second stage that changes no box and scores boxes along x highest."""

    def forward(self, points, context):
        del points
        # the bearing of what lies straight ahead, seen in the frame of a box along x, is 0 or pi
        along = context[:, 4].abs()
        zeros = context.new_zeros(len(context), 8)
        return RegionOutput(zeros, along.new_ones(len(along)), 8 * along - 4)


@pytest.fixture
def sample():
    return simulated_frames()[0]


def with_axes(**settings):
    config = replace(COMPACT, axes=HeadingHypothesesConfig(**settings))
    detector = Detector3D(config).eval()
    assert detector.second is not None
    detector.second.network = _PrefersBoxesAlongX()
    return detector


def test_a_proposal_across_ends_along_the_axis_that_the_second_stage_is_sure_of(sample):
    detector = with_axes(class_names=("Car",), number=4, passes=1)
    sweep = network_sweep(sample, detector.config.input)
    across = torch.tensor([[20.0, 0, -1, 4, 1.6, 1.5, math.pi / 2]]).repeat(2, 1)
    across[1, 0] = 40.0
    proposed = Proposed(across, torch.tensor([0, 1]), torch.tensor([0.9, 0.9]))
    found = refine(detector, sweep, proposed)
    axis = {
        name: abs(math.cos(yaw))
        for name, yaw in zip(found.class_names, found.boxes.tensor[:, 6].tolist(), strict=True)
    }
    assert axis["Car"] == pytest.approx(1, abs=1e-4)
    assert axis["Pedestrian"] == pytest.approx(0, abs=1e-4)  # a class that is not named
    plain = refine(detector, sweep, proposed, in_use=False)
    assert plain.boxes.tensor[:, 6].cos().abs().max() < 1e-4


def test_where_no_other_axis_can_gain_answers_are_those_without(sample):
    detector = Detector3D(replace(COMPACT, axes=HeadingHypothesesConfig(least_gain=1e9))).eval()
    sweep = network_sweep(sample, detector.config.input)
    proposed = propose(detector, sweep)[0]
    found, plain = (refine(detector, sweep, proposed, in_use=each) for each in (True, False))
    torch.testing.assert_close(found.boxes.tensor, plain.boxes.tensor)
    torch.testing.assert_close(found.scores, plain.scores)


def test_settings_that_make_no_sense_are_refused():
    for message, settings in (
        ("axes.number must be from 2 to 16, got 1", {"number": 1}),
        ("axes.passes must be at least 1, got 0", {"passes": 0}),
        ("axes.least_gain must be finite", {"least_gain": -0.1}),
        ("axes.class_names must hold", {"class_names": ()}),
    ):
        with pytest.raises(ValueError, match=message):
            HeadingHypothesesConfig(**settings)
    for message, axes in (
        ("axes names Tram, but the classes are", HeadingHypothesesConfig(class_names=("Tram",))),
        ("axes.passes is 9, expected up to regions.passes", HeadingHypothesesConfig(passes=9)),
    ):
        with pytest.raises(ValueError, match=message):
            replace(COMPACT, axes=axes)
    large = replace(COMPACT.regions, num_points=2**14, region_width=512)
    replace(COMPACT, regions=large)
    with pytest.raises(ValueError, match=r"regions makes layers of \d+ numbers of a proposal"):
        replace(COMPACT, regions=large, axes=HeadingHypothesesConfig(number=16))
    with pytest.raises(ValueError, match="axes needs regions in their own frames"):
        replace(
            COMPACT,
            regions=replace(COMPACT.regions, canonical=False),
            axes=HeadingHypothesesConfig(),
        )

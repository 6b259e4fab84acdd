"""Result of several second-stage passes: the last pass, or its mean with the first."""

import math
from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.detection3d.config import HeadingHypothesesConfig
from sightline.detection3d.detector import (
    Detector3D,
    combine_passes,
    mean_refined,
    propose,
    refine,
)
from sightline.detection3d.pillars.regions import RegionOutput
from sightline.detection3d.stages import Proposed, Refined
from sightline.detection3d.sweeps import network_sweep
from tests.detection3d.frames import COMPACT, NAMES, simulated_frames
from tests.reference.passes import mean_box

seeds = st.integers(0, 10**6)


def random_passes(seed, passes, count):
    """Boxes whose axes differ by up to 45 degrees from pass to pass, their fronts at any end."""
    rng = torch.Generator().manual_seed(seed)
    drawn = torch.rand(passes, count, 9, generator=rng, dtype=torch.float64)
    first = math.tau * torch.rand(count, generator=rng, dtype=torch.float64)
    is_turned = torch.rand(passes, count, generator=rng) < 0.5
    yaws = first + math.pi / 4 * drawn[..., 6] + math.pi * is_turned
    boxes = torch.cat((10 * drawn[..., :3] - 5, drawn[..., 3:6] + 0.5, yaws[..., None]), dim=-1)
    return [Refined(*each) for each in zip(boxes, *drawn[..., 7:].unbind(dim=-1), strict=True)]


def assert_same_boxes(found, expected):
    torch.testing.assert_close(found[:, :6], expected[:, :6])
    torch.testing.assert_close(
        (found[:, 6] - expected[:, 6]).cos(), torch.ones(len(found)).double()
    )


@given(seed=seeds, passes=st.integers(2, 4), count=st.integers(0, 5))
def test_the_mean_is_that_of_the_reference(seed, passes, count):
    refined = random_passes(seed, passes, count)
    found = mean_refined(*refined)
    means = [
        mean_box([e.boxes[row].tolist() for e in refined], [e.front_logits[row] for e in refined])
        for row in range(count)
    ]
    assert_same_boxes(found.boxes, torch.tensor(means, dtype=torch.float64).reshape(-1, 7))
    torch.testing.assert_close(found.scores, sum(each.scores for each in refined) / passes)
    assert ((found.boxes[:, 6] >= -math.pi) & (found.boxes[:, 6] < math.pi)).all()


@given(seed=seeds, turn=st.floats(-3, 3))
def test_a_turned_scene_has_the_turned_mean(seed, turn):
    refined = random_passes(seed, 3, 4)
    by = torch.tensor([0, 0, 0, 0, 0, 0, turn], dtype=torch.float64)
    turned = mean_refined(*(each._replace(boxes=each.boxes + by) for each in refined))
    assert_same_boxes(turned.boxes, mean_refined(*refined).boxes + by)


def test_the_surer_pass_says_where_the_front_is():
    box = torch.tensor([[9.0, 0, -1, 4, 1.6, 1.5, 0.1]])
    back = box + torch.tensor([0, 0, 0, 0, 0, 0, math.pi])
    one = torch.ones(1)
    for front_logit, yaw in ((2.0, 0.1), (0.5, 0.1 - math.pi)):
        found = mean_refined(Refined(box, one, front_logit * one), Refined(back, one, one))
        assert float(found.boxes[0, 6]) == pytest.approx(yaw)
        assert float(found.front_logits) == pytest.approx(abs(front_logit - 1) / 2)


@given(seed=seeds, passes=st.integers(1, 3))
def test_some_boxes_are_the_mean_of_first_and_last_and_others_the_last(seed, passes):
    refined = random_passes(seed, passes, 6)
    is_mean = torch.tensor([True, False, True, False, False, True])
    found = combine_passes(refined, is_mean)
    mean = mean_refined(refined[0], refined[-1])
    for values, last, means in zip(found, refined[-1], mean, strict=True):
        assert torch.equal(values[~is_mean], last[~is_mean])
        assert torch.equal(values[is_mean], means[is_mean])


class _Moves(torch.nn.Module):
    """Moves a box of 4 m by 0.6 m ahead; its logits fall with each call."""

    def __init__(self):
        super().__init__()
        self.num_calls = 0

    def forward(self, points, context):
        del points
        values = context.new_zeros(len(context), 8)
        values[:, 0] = 1.0
        self.num_calls += 1
        front = context.new_ones(len(context))
        return RegionOutput(values, front, front / self.num_calls)


def moved(axes=None, **regions):
    """Places along x of a car and a cyclist proposed at 10 and 20 m, and scores, by class."""
    config = replace(COMPACT, regions=replace(COMPACT.regions, **regions), axes=axes)
    detector = Detector3D(config).eval()
    assert detector.second is not None
    detector.second.network = _Moves()
    sweep = network_sweep(simulated_frames()[0], config.input)
    boxes = torch.tensor([[10.0, 0, -1, 4, 1.6, 1.5, 0], [20.0, 0, -1, 4, 1.6, 1.5, 0]])
    proposed = Proposed(boxes, torch.tensor([0, 2]), torch.ones(2))
    found = refine(detector, sweep, proposed)
    rows = zip(found.boxes.tensor[:, 0].tolist(), found.scores.tolist(), strict=True)
    return dict(zip(found.class_names, rows, strict=True))


def expected_score(num_calls):
    """Score of a proposal with score 1 after the given number of calls."""
    return math.sqrt(1 / (1 + math.exp(-1 / num_calls)))


def test_the_named_classes_have_the_mean_and_others_the_last_pass():
    found = moved(passes=3, mean_with_first=("Cyclist",))
    assert found["Car"] == pytest.approx((11.8, expected_score(3)))
    assert found["Cyclist"] == pytest.approx((21.2, (expected_score(1) + expected_score(3)) / 2))


def test_the_mean_is_of_the_passes_from_the_axis_that_was_taken():
    axes = HeadingHypothesesConfig(class_names=("Car",), passes=1, least_gain=0.5)
    found = moved(axes, passes=2, mean_with_first=("Car",))
    assert found["Car"] == pytest.approx((10.9, (expected_score(1) + expected_score(2)) / 2))
    assert found["Cyclist"] == pytest.approx((21.2, expected_score(2)))


def test_nothing_proposed_has_no_mean():
    config = replace(COMPACT, regions=replace(COMPACT.regions, mean_with_first=NAMES))
    detector = Detector3D(config).eval()
    sweep = network_sweep(simulated_frames()[0], config.input)
    nothing = Proposed(*(values[:0] for values in propose(detector, sweep)[0][:3]))
    assert len(refine(detector, sweep, nothing).scores) == 0


def test_a_class_that_is_not_looked_for_is_refused():
    with pytest.raises(ValueError, match="mean_with_first names Tram, but the classes are Car, "):
        replace(COMPACT.regions, mean_with_first=("Car", "Tram"))

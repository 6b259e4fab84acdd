import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.augmentation.faults import TurnedLidar
from sightline.health.yaw_error import (
    _mean_strength,
    estimate_yaw,
    find_depth_edges,
    match_edges,
)
from tests.health.frames import sound, with_image
from tests.reference import health as reference

RNG = np.random.default_rng(0)


@pytest.mark.parametrize("yaw_deg", [-2.7, -1.0, -0.3, 0.0, 0.5, 1.5, 3.0])
def test_a_turn_is_found_again(yaw_deg):
    turned = TurnedLidar(yaw_deg=yaw_deg)(sound(), RNG)
    assert estimate_yaw(match_edges(turned)).yaw_deg == pytest.approx(yaw_deg, abs=0.1)


def test_frames_are_worth_the_same_in_any_order_and_grouping():
    turn = TurnedLidar(yaw_deg=0.8)
    frames = [turn(sound(0), RNG), turn(sound(1), RNG)]
    first, second = map(match_edges, frames)
    together = estimate_yaw(first + second)
    assert together.yaw_deg == pytest.approx(0.8, abs=0.05)
    assert estimate_yaw(second + first) == together
    assert (first + second).num_edges == first.num_edges + second.num_edges
    assert estimate_yaw(first.faded(0.0) + second).yaw_deg == estimate_yaw(second).yaw_deg


def test_whole_sweeps_and_those_cut_to_the_view_tell_the_same():
    behind = sound().points.clone()
    behind[:, :2] *= -1
    whole = replace(sound(), points=torch.cat((sound().points, behind)))
    cut, uncut = (estimate_yaw(match_edges(each)) for each in (sound(), whole))
    assert uncut.yaw_deg == cut.yaw_deg


def test_without_a_sensor_or_edges_nothing_is_told():
    for lacking in ("image", "points"):
        assert match_edges(replace(sound(), **{lacking: None})) is None
    assert match_edges(replace(sound(), points=torch.zeros(0, 4))) is None
    assert match_edges(replace(sound(), points=torch.ones(500, 4))) is None


def test_a_blank_image_tells_no_turn():
    match = match_edges(with_image(sound(), np.zeros_like))
    assert match.curves.std() == 0
    assert math.isfinite(estimate_yaw(match).yaw_deg)
    assert estimate_yaw(match).prominence == 0


def test_edges_lie_half_a_step_beside_the_nearer_point():
    azimuth = np.radians([2.0, 1.0, 0.0, -1.0])
    ranges = np.array([10.0, 10.0, 5.0, 5.1])
    points = np.stack(
        (ranges * np.cos(azimuth), ranges * np.sin(azimuth), 0 * ranges, 0 * ranges), axis=1
    )
    places, weights = find_depth_edges(points.astype(np.float32))
    assert len(places) == 1
    assert np.degrees(np.arctan2(places[0, 1], places[0, 0])) == pytest.approx(0.5, abs=1e-4)
    assert np.hypot(*places[0, :2]) == pytest.approx(5.0)
    assert weights[0] == pytest.approx(math.log(2))


@given(seed=st.integers(0, 1000), angle=st.floats(-0.1, 0.1))
def test_the_match_is_that_of_a_plain_loop(seed, angle):
    rng = np.random.default_rng(seed)
    points = rng.uniform((0, -5, -2), (30, 5, 2), (12, 3))
    weights, strength = rng.random(12), rng.random((20, 30)).astype(np.float32)
    matrix = np.array([[15.0, -20, 0, 0], [10, 0, -20, 0.3], [1, 0, 0, 0]])
    found = _mean_strength(points, weights, matrix, strength, np.array([0.0, angle]))
    expected = [
        reference.mean_strength(points, weights, matrix, strength, each) for each in (0.0, angle)
    ]
    assert found == pytest.approx(expected, abs=1e-6)

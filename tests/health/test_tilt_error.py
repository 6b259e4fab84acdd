import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from sightline.augmentation.faults import TurnedLidar
from sightline.health.tilt_error import (
    _strength_by_part,
    edge_strength,
    estimate_tilt,
    find_top_edges,
)
from sightline.health.yaw_error import match_edges
from tests.health.frames import sound, with_image
from tests.reference import health as reference

RNG = np.random.default_rng(0)
IMAGE = RNG.integers(0, 256, (97, 130, 3), dtype=np.uint8)


def tops_of(*samples):
    first, *others = [match_edges(sample).tops for sample in samples]
    return sum(others, start=first)


@pytest.mark.parametrize(
    ("pitch_deg", "roll_deg"), [(0.0, 0.0), (1.0, 0.0), (-1.2, 0.0), (0.8, -0.8), (0.0, 1.0)]
)
def test_a_tilt_is_found_again(pitch_deg, roll_deg):
    turn = TurnedLidar(pitch_deg=pitch_deg, roll_deg=roll_deg)
    found = estimate_tilt(tops_of(turn(sound(0), RNG), turn(sound(1), RNG)))
    assert found.pitch_deg == pytest.approx(pitch_deg, abs=0.33)
    assert found.roll_deg == pytest.approx(roll_deg, abs=0.41)
    assert (found.behind > 0.3) == bool(pitch_deg or roll_deg)


def test_frames_are_worth_the_same_in_any_order_and_what_is_faded_counts_less():
    first, second = tops_of(sound(0)), tops_of(sound(1))
    assert estimate_tilt(first + second) == estimate_tilt(second + first)
    assert estimate_tilt(first.faded(0.0) + second) == estimate_tilt(second)
    assert estimate_tilt(first.faded(0.5)) == pytest.approx(estimate_tilt(first))


def test_a_blank_image_tells_no_tilt():
    found = estimate_tilt(tops_of(with_image(sound(), np.zeros_like)))
    assert found.behind == 0
    assert math.isfinite(found.pitch_deg)


def test_no_points_have_no_tops():
    assert len(find_top_edges(np.zeros((0, 4), np.float32)).weights) == 0
    assert len(find_top_edges(np.ones((500, 4), np.float32)).weights) == 0


def test_a_top_lies_halfway_between_the_rings_at_the_nearer_range():
    rays = [(-2.0, [9.0, 1.0, 0.0], 30.0), (-3.0, [0.1, 0.9, 8.0], 10.0), (-4.0, [1.0], 10.2)]
    rows = []
    for elevation_deg, azimuths_deg, distance in rays:
        for azimuth_deg in sorted(azimuths_deg):
            tilt, turn = math.radians(elevation_deg), math.radians(azimuth_deg)
            flat = distance * math.cos(tilt)
            place = (flat * math.cos(turn), flat * math.sin(turn), distance * math.sin(tilt), 0.5)
            rows.append((elevation_deg, azimuth_deg, place))
    # The azimuth falls back by a whole view from ring to ring.
    left, right = (-2.0, 35.0, (24.5, 17.2, -1.0, 0.5)), (-3.0, -35.0, (8.2, -5.7, -0.5, 0.5))
    points = [row[2] for row in rows[:3]] + [left[2], right[2]] + [row[2] for row in rows[3:6]]
    found = find_top_edges(np.array(points, np.float32))
    azimuths = np.degrees(np.arctan2(found.places[:, 1], found.places[:, 0]))
    assert azimuths == pytest.approx([0.1, 0.9], abs=1e-3)
    assert np.linalg.norm(found.places, axis=1) == pytest.approx([10, 10], rel=1e-5)
    elevations = np.degrees(np.arcsin(found.places[:, 2] / 10))
    assert elevations == pytest.approx([-2.5, -2.5], abs=1e-3)
    assert found.weights == pytest.approx([1, 1])


@settings(max_examples=30)
@given(seed=st.integers(0, 1000), angle=st.floats(-0.1, 0.1))
def test_the_match_is_that_of_a_plain_loop(seed, angle):
    rng = np.random.default_rng(seed)
    points = rng.uniform((0, -5, -2), (30, 5, 2), (12, 3))
    weights, parts = rng.random(12), rng.integers(0, 3, 12)
    strength = rng.random((20, 30)).astype(np.float32)
    matrix = np.array([[15.0, -20, 0, 0], [10, 0, -20, 0.3], [1, 0, 0, 0]])
    sums, totals = _strength_by_part(
        points, weights, parts, matrix, strength, np.array([0.0, angle]), 3
    )
    for number, each in enumerate((0.0, angle)):
        for part in range(3):
            of = parts == part
            expected = reference.tilted_strength(points[of], weights[of], matrix, strength, each)
            assert (sums[part, number], totals[part, number]) == pytest.approx(expected, abs=1e-6)


def test_sweeps_cut_to_another_view_tell_the_same():
    behind = sound().points.clone()
    behind[:, :2] *= -1
    whole = replace(sound(), points=torch.cat((sound().points, behind)))
    assert estimate_tilt(tops_of(whole)) == estimate_tilt(tops_of(sound()))


@pytest.mark.parametrize("gradient", ["horizontal", "vertical"])
def test_edge_strength_is_what_the_reference_says(gradient):
    grey = cv2.cvtColor(IMAGE, cv2.COLOR_RGB2GRAY)
    expected = reference.edge_strength(grey, axis=1 if gradient == "horizontal" else 0)
    assert_allclose(edge_strength(IMAGE, gradient), expected, atol=0.01)


def test_edge_strength_of_either_direction_is_the_other_of_the_image_on_its_side():
    on_its_side = np.ascontiguousarray(IMAGE.swapaxes(0, 1))
    assert_allclose(
        edge_strength(IMAGE, "vertical").T, edge_strength(on_its_side, "horizontal"), atol=1e-4
    )


def test_an_edge_is_seen_across_it_alone():
    image = np.zeros((60, 120, 3), np.uint8)
    image[:, 60:] = 40
    assert edge_strength(image, "vertical").max() == 0
    strength = edge_strength(image, "horizontal")
    assert set(strength.argmax(axis=1)) <= {59, 60}


def test_a_faint_edge_far_from_others_counts_for_more_than_its_share():
    image = np.zeros((90, 400, 3), np.uint8)
    image[:, 100:] = 10
    image[:, 300:] = 250  # 24 times as strong
    strength = edge_strength(image, "horizontal")[45]
    assert strength[100] > 0.3 * strength[300]

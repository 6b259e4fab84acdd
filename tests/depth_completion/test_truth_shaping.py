import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sightline.depth_completion.truth_shaping import (
    AS_SIMULATED,
    TruthShaping,
    pixel_weights,
    widen_near_surfaces,
)
from tests.reference import truth_shaping as reference

WEIGHTS = TruthShaping(thin_weight=0.5, away_weight=0.25, kept_weight=0.0)


def blocks(seed, shape=(14, 17)):
    """Random surfaces of several depths, some without truth."""
    rng = np.random.default_rng(seed)
    depth = np.full(shape, rng.choice([0.0, 30.0, 60.0]), np.float32)
    for _ in range(int(rng.integers(0, 5))):
        (top, left), (height, width) = rng.integers(0, 12, 2), rng.integers(1, 9, 2)
        depth[top : top + height, left : left + width] = rng.choice([0.0, 8.0, 15.0, 22.0, 23.0])
    return depth


@given(st.integers(0, 2**31), st.integers(1, 3), st.sampled_from([0.0, 20.0, 1000.0]))
def test_near_surfaces_are_widened_as_loops_over_windows_say(seed, contours_px, within_m):
    truth = blocks(seed)
    shaping = TruthShaping(contours_px=contours_px, contours_within_m=within_m)
    expected = reference.widened(truth.tolist(), contours_px, within_m)
    assert widen_near_surfaces(truth, shaping).tolist() == expected


def test_a_level_road_is_no_contour():
    rows = np.arange(1, 150, dtype=np.float32)
    road = np.repeat((721 * 1.65 / (10 + rows))[:, None], 20, axis=1)
    shaping = TruthShaping(contours_px=2)
    assert (widen_near_surfaces(road, shaping) == road).all()


@given(st.integers(0, 2**31))
@settings(max_examples=20)
def test_weights_are_the_product_of_what_applies(seed):
    rng, truth = np.random.default_rng(seed), blocks(seed)
    depth = rng.uniform(5, 60, truth.shape).astype(np.float32)
    all_beams = np.where(rng.random(truth.shape) < 0.02, depth, np.float32(0))
    sparse = np.where(rng.random(truth.shape) < 0.5, all_beams, np.float32(0))
    filled = np.where(rng.random(truth.shape) < 0.5, depth, depth + 1).astype(np.float32)
    weights = pixel_weights(truth, sparse, filled, WEIGHTS, all_beams_m=all_beams)
    lists = [each.tolist() for each in (truth, sparse, filled, all_beams)]
    for y, x in rng.integers(0, truth.shape, (20, 2)).tolist():
        assert weights[y, x] == reference.weight(*lists, y, x, WEIGHTS)


def test_by_default_nothing_changes():
    truth = blocks(3)
    assert widen_near_surfaces(truth, AS_SIMULATED) is truth
    assert (pixel_weights(truth, truth, None, AS_SIMULATED) == 1).all()


@pytest.mark.parametrize("settings", [{"contours_px": -1}, {"thin_weight": float("nan")}])
def test_settings_out_of_range_are_refused_by_name(settings):
    with pytest.raises(ValueError, match=f"{next(iter(settings))} must be at least 0"):
        TruthShaping(**settings)

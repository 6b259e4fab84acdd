import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.depth_completion.config import PlaneSmoothing
from sightline.depth_completion.postprocess import (
    FARTHEST_M,
    NEAREST_M,
    TRUSTED_SHARE,
    only_valid,
    to_depth_map,
)
from sightline.structures.predictions import DepthMap

ANY = st.floats(width=32)  # NaN and the infinities too


def one_pixel(depth_m, uncertainty_m=None, *, is_supported=True):
    """Depth, validity and uncertainty of a map of one pixel."""
    result = to_depth_map(
        torch.tensor([[depth_m]]),
        None if uncertainty_m is None else torch.tensor([[uncertainty_m]]),
        is_supported=torch.tensor([[is_supported]]),
    )
    uncertainty = None if result.uncertainty_m is None else result.uncertainty_m.item()
    return result.depth_m.item(), result.valid.item(), uncertainty


@given(depth_m=ANY, is_supported=st.booleans())
def test_a_depth_is_none_or_within_the_sensors_range(depth_m, is_supported):
    depth, valid, _ = one_pixel(depth_m, is_supported=is_supported)
    if math.isfinite(depth_m):
        assert depth == pytest.approx(min(max(depth_m, NEAREST_M), FARTHEST_M))
        assert valid == is_supported
    else:
        assert (depth, valid) == (0, False)


@given(depth_m=ANY, uncertainty_m=ANY, is_supported=st.booleans())
def test_what_is_valid_has_a_depth_among_measurements_and_a_small_expected_error(
    depth_m, uncertainty_m, is_supported
):
    depth, valid, uncertainty = one_pixel(depth_m, uncertainty_m, is_supported=is_supported)
    is_known = math.isfinite(depth_m) and uncertainty_m >= 0
    assert uncertainty == (uncertainty_m if is_known else math.inf)
    assert valid == (is_supported and uncertainty < TRUSTED_SHARE * depth)


def test_an_expected_error_just_beyond_the_share_is_a_guess():
    assert one_pixel(10.0, 10 * TRUSTED_SHARE - 0.01)[1]
    assert not one_pixel(10.0, 10 * TRUSTED_SHARE + 0.01)[1]


def test_half_precision_becomes_single_and_gradients_end():
    depth_m = torch.full((2, 3), 20.0, dtype=torch.bfloat16, requires_grad=True)
    result = to_depth_map(depth_m, depth_m, is_supported=torch.ones(2, 3, dtype=torch.bool))
    assert result.depth_m.dtype == result.uncertainty_m.dtype == torch.float32
    assert not result.depth_m.requires_grad


@pytest.mark.parametrize("with_error", [False, True])
def test_without_guesses_a_map_has_its_valid_depths_and_nothing_else(with_error):
    depth_m = torch.tensor([[1.0, 2.0], [3.0, 0.0]])
    guessing = DepthMap(
        depth_m=depth_m,
        valid=torch.tensor([[True, False], [True, True]]),
        uncertainty_m=torch.tensor([[0.1, 0.2], [0.3, 0.4]]) if with_error else None,
    )
    kept = only_valid(guessing)
    assert kept.depth_m.tolist() == [[1.0, 0.0], [3.0, 0.0]]
    assert torch.equal(kept.valid, kept.depth_m > 0)
    if with_error:
        expected = torch.tensor([[0.1, torch.inf], [0.3, 0.4]])
        assert torch.equal(kept.uncertainty_m, expected)
    else:
        assert kept.uncertainty_m is None
    assert torch.equal(only_valid(kept).depth_m, kept.depth_m)


def test_smoothing_invents_no_depth_and_stays_within_the_sensors_range():
    depth_m = torch.full((9, 9), 130.0)
    depth_m[:, 4] = 0.1
    depth_m[3, 3] = math.nan
    result = to_depth_map(
        depth_m,
        None,
        is_supported=torch.ones(9, 9, dtype=torch.bool),
        smoothing=PlaneSmoothing(windows_px=(3,), noise_m=5.0),
    )
    assert result.depth_m[3, 3] == 0
    assert not result.valid[3, 3]
    others = result.depth_m[result.valid]
    assert len(others) == 80
    assert others.min() >= NEAREST_M
    assert others.max() <= FARTHEST_M

import itertools

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.depth_completion.targets import ExpansionConfig, _median_network, expand_depth
from tests.depth_completion.sparse_maps import random_map, random_maps
from tests.reference import expansion as reference

small_maps = random_maps(max_rows=12, max_columns=14)
repeated_variants = pytest.mark.parametrize(
    ("variant", "pick"), [("repeated", max), ("near_wins", min)]
)


def expand(*maps, **config):
    batch = torch.from_numpy(np.stack(maps)[:, None])
    return expand_depth(batch, ExpansionConfig(**config))[:, 0].numpy()


@repeated_variants
@given(sparse=small_maps)
def test_gaps_take_the_largest_or_smallest_of_the_nearest_measurements(variant, pick, sparse):
    expanded = expand(sparse, variant=variant, median_px=1)[0]
    assert expanded.tolist() == reference.fill(sparse.tolist(), pick=pick)


@repeated_variants
@given(sparse=small_maps, side_px=st.sampled_from([3, 5, 7]))
def test_the_filled_map_then_goes_through_a_median(variant, pick, sparse, side_px):
    expanded = expand(sparse, variant=variant, median_px=side_px)[0]
    filled = reference.fill(sparse.tolist(), pick=pick)
    assert expanded.tolist() == reference.median(filled, side_px)


@given(sparse=small_maps, literal_px=st.sampled_from([1, 3, 15]))
def test_the_literal_variant_is_one_maximum_and_a_median(sparse, literal_px):
    expanded = expand(sparse, variant="literal", literal_px=literal_px)[0]
    widened = reference.maximum(sparse.tolist(), literal_px)
    assert expanded.tolist() == reference.median(widened, 5)


def test_the_default_is_the_repeated_maximum_and_a_median_of_5_pixels():
    sparse = random_map(3, (40, 60), 0.05)
    filled = np.array(reference.fill(sparse.tolist(), pick=max), np.float32)
    assert (expand(sparse)[0] == cv2.medianBlur(filled, 5)).all()


@pytest.mark.parametrize("side_px", [3, 5])
def test_the_median_network_is_right_for_all_windows_with_sorted_columns(side_px):
    # A network that is right for all zeros and ones is right for all numbers (Knuth 3, 5.3.4).
    comparators, median = _median_network(side_px)
    for ones in itertools.product(range(side_px + 1), repeat=side_px):
        window = [row >= side_px - count for row in range(side_px) for count in ones]
        for low, high, makes_low, makes_high in comparators:
            lower, upper = window[low], window[high]
            if makes_low:
                window[low] = lower and upper
            if makes_high:
                window[high] = lower or upper
        assert window[median] == (sum(ones) > side_px * side_px // 2)


@pytest.mark.parametrize("variant", ["repeated", "near_wins"])
def test_one_measurement_fills_the_whole_map_from_any_corner(variant):
    for row, column in ((0, 0), (0, 39), (29, 0), (29, 39)):
        sparse = np.zeros((30, 40), np.float32)
        sparse[row, column] = 12.3
        assert (expand(sparse, variant=variant)[0] == np.float32(12.3)).all()


@pytest.mark.parametrize("variant", ["repeated", "near_wins", "literal"])
def test_an_empty_map_stays_empty_and_does_not_change_its_neighbours_in_the_batch(variant):
    sparse = random_map(1, (20, 30), 0.02)
    expanded = expand(np.zeros_like(sparse), sparse, variant=variant)
    assert not expanded[0].any()
    assert (expanded[1] == expand(sparse, variant=variant)[0]).all()


def test_pixels_midway_between_a_near_and_a_far_measurement_go_to_the_near_one_if_near_wins():
    sparse = np.zeros((32, 32), np.float32)
    sparse[::4, ::4] = 40.0
    sparse[8:24:4, 8:24:4] = 8.0
    for variant, side in (("repeated", 15), ("near_wins", 17)):
        expanded = expand(sparse, variant=variant, median_px=1)[0]
        assert np.count_nonzero(expanded == 8.0) == side * side


def test_the_input_is_left_alone_and_gets_no_gradient():
    sparse = torch.from_numpy(random_map(2, (1, 1, 12, 12), 0.2)).requires_grad_()
    before = sparse.detach().clone()
    assert not expand_depth(sparse).requires_grad
    assert torch.equal(sparse, before)


@pytest.mark.parametrize("name", ["literal_px", "median_px"])
@pytest.mark.parametrize("side_px", [0, 4, -3])
def test_a_window_without_a_centre_is_refused(name, side_px):
    with pytest.raises(ValueError, match=f"{name} must be odd, .*got {side_px}"):
        ExpansionConfig(**{name: side_px})


def test_an_unknown_variant_is_refused_by_name():
    # typed runs refuse it before the class does
    with pytest.raises((ValueError, TypeError), match="far_wins"):
        ExpansionConfig(variant="far_wins")

from typing import get_args

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from sightline.depth_completion.adaptive import adaptive_depth
from sightline.depth_completion.classical import classical_depth
from sightline.depth_completion.interpolation import linear_depth, nearest_depth
from sightline.depth_completion.methods import Method, complete_depth
from tests.depth_completion.sparse_maps import random_map, random_maps

METHODS = get_args(Method)
BY_NAME = {
    "nearest": nearest_depth,
    "linear": linear_depth,
    "classical": classical_depth,
    "adaptive": adaptive_depth,
}


@pytest.mark.parametrize("method", METHODS)
def test_a_name_stands_for_its_function_and_takes_arrays_and_tensors(method):
    sparse = random_map(1, (30, 40), 0.1)
    expected = BY_NAME[method](sparse)
    for given_map in (sparse, torch.from_numpy(sparse)):
        dense = complete_depth(given_map, method)
        assert torch.equal(dense.depth_m, expected.depth_m)
        assert torch.equal(dense.valid, expected.valid)


@given(random_maps(), st.sampled_from(METHODS))
@settings(max_examples=200)
def test_no_map_makes_a_method_fail_or_give_anything_but_depths(sparse, method):
    before = sparse.copy()
    dense = complete_depth(sparse, method)
    assert dense.depth_m.shape == sparse.shape
    assert dense.depth_m.isfinite().all()
    assert (dense.depth_m >= 0).all()
    assert (dense.depth_m[dense.valid] > 0).all()
    assert (sparse == before).all()
    assert torch.equal(dense.depth_m, complete_depth(sparse, method).depth_m)
    if method in ("nearest", "adaptive") and sparse.any():
        assert (dense.depth_m > 0).all()


@pytest.mark.parametrize("method", METHODS)
def test_a_scene_of_one_depth_comes_out_as_one_depth(method):
    sparse = np.where(random_map(2, (40, 60), 0.2) > 0, np.float32(12.5), np.float32(0))
    dense = complete_depth(sparse, method)
    np.testing.assert_allclose(dense.depth_m[dense.valid], 12.5, rtol=1e-5)


@pytest.mark.parametrize("method", METHODS)
def test_one_measurement_is_kept_and_little_else_is_called_valid(method):
    sparse = np.zeros((40, 60), np.float32)
    sparse[20, 30] = 12.5
    dense = complete_depth(sparse, method)
    assert dense.depth_m[20, 30] == pytest.approx(12.5, rel=1e-5) or method == "classical"
    assert dense.valid.sum() < 150


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf])
def test_a_pixel_that_is_no_depth_is_refused_with_its_place(method, value):
    sparse = random_map(3, (10, 12), 0.5)
    sparse[4, 7] = value
    with pytest.raises(ValueError, match=rf"holds {value} in row 4, column 7; depths are"):
        complete_depth(sparse, method)


@pytest.mark.parametrize("method", METHODS)
def test_a_map_without_pixels_is_refused(method):
    with pytest.raises(ValueError, match=r"has the shape \(0, 12\), which holds no pixel"):
        complete_depth(np.zeros((0, 12), np.float32), method)

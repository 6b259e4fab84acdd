import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sightline.depth_completion.classical import ClassicalConfig, classical_depth
from tests.depth_completion.sparse_maps import IMAGE, random_maps
from tests.reference import morphology as reference
from tests.settings import set_unchecked

blurs = st.sampled_from(["gaussian", "bilateral"])


@given(
    st.integers(0, 2**31),
    st.tuples(st.integers(1, 14), st.integers(1, 14)),
    st.sampled_from([0.0, 0.02, 0.1, 0.5]),
    blurs,
    st.booleans(),
)
@settings(max_examples=60)
def test_every_step_does_what_the_published_algorithm_says(seed, shape, density, blur, extrapolate):
    rng = np.random.default_rng(seed)
    # quarters, so that inversion is exact; some beyond the largest depth
    depth = (rng.integers(1, 420, shape) / 4).astype(np.float32)
    sparse = np.where(rng.random(shape) < density, depth, np.float32(0))
    dense = classical_depth(sparse, ClassicalConfig(blur=blur, extrapolate=extrapolate))
    expected, valid = reference.complete(sparse.tolist(), blur=blur, extrapolate=extrapolate)
    np.testing.assert_allclose(dense.depth_m, np.array(expected), atol=2e-3)
    assert dense.valid.tolist() == valid


@given(random_maps(), blurs, st.booleans())
def test_what_is_valid_has_a_depth_and_all_depths_are_sane(sparse, blur, extrapolate):
    config = ClassicalConfig(blur=blur, extrapolate=extrapolate, max_depth_m=40.0)
    dense = classical_depth(sparse, config)
    assert (dense.depth_m[dense.valid] > 0).all()
    assert (dense.depth_m >= 0).all()
    assert (dense.depth_m <= config.max_depth_m).all()
    assert sparse.any() or not dense.depth_m.any()


def test_a_near_surface_wins_over_a_far_one_that_shows_through():
    sparse = np.zeros((40, 40), np.float32)
    sparse[::3, ::3] = 40.0
    sparse[10:30:4, 10:30:4] = 8.0
    depth = classical_depth(sparse).depth_m.numpy()
    np.testing.assert_allclose(depth[14:26, 14:26], 8.0, atol=0.1)


def test_extrapolation_reaches_the_top_but_is_not_called_valid():
    sparse = np.zeros((100, 60), np.float32)
    sparse[60::3, ::2] = 20.0
    plain = classical_depth(sparse, ClassicalConfig(extrapolate=False))
    extended = classical_depth(sparse)
    assert not plain.depth_m[:40].any()
    np.testing.assert_allclose(extended.depth_m[:40], 20.0, atol=1e-4)
    assert not extended.valid[:40].any()
    assert extended.valid[65:].all()


def test_large_holes_are_filled_up_to_fifteen_pixels_away():
    sparse = np.zeros((80, 80), np.float32)
    sparse[40, 40] = 20.0
    # Diamond and small holes reach 5 pixels to the side; the closing changes nothing.
    reached = classical_depth(sparse).depth_m.numpy() > 0
    rows, columns = np.nonzero(reached)
    assert (columns.min(), columns.max(), rows.max()) == (40 - 20, 40 + 20, 40 + 20)


@pytest.mark.parametrize("max_depth_m", [0.0, 0.2, float("inf"), float("nan")])
def test_a_largest_depth_that_leaves_no_room_is_refused(max_depth_m):
    with pytest.raises(ValueError, match=r"max_depth_m must be above 0\.2 and finite"):
        ClassicalConfig(max_depth_m=max_depth_m)


def test_an_empty_map_of_full_size_stays_empty():
    dense = classical_depth(np.zeros(IMAGE, np.float32))
    assert not dense.depth_m.any()
    assert not dense.valid.any()


def test_a_blur_that_there_is_not_is_refused():
    with pytest.raises(ValueError, match="blur must be gaussian or bilateral, got 'median'"):
        set_unchecked(ClassicalConfig(), blur="median")

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sightline.depth_completion.interpolation import linear_depth, nearest_depth
from tests.depth_completion.sparse_maps import plane, random_map, random_maps
from tests.reference import interpolation as reference

# nearest


@given(random_maps(max_rows=8, max_columns=10))
@settings(max_examples=60)
def test_every_pixel_takes_the_depth_of_a_nearest_measurement(sparse):
    dense = nearest_depth(sparse)
    allowed = reference.nearest(sparse.tolist())
    if not sparse.any():
        assert not dense.depth_m.any()
        assert not dense.valid.any()
        return
    for row, choices in zip(dense.depth_m.tolist(), allowed, strict=True):
        for depth, choice in zip(row, choices, strict=True):
            assert depth in choice


def test_nearest_is_valid_between_measurements_and_a_guess_around_them():
    sparse = np.zeros((9, 12), np.float32)
    sparse[2:7:4, 3:9:5] = 5.0
    expected = np.zeros(sparse.shape, bool)
    expected[2:7, 3:9] = True
    assert (nearest_depth(sparse).valid.numpy() == expected).all()


# linear


@given(random_maps())
@settings(max_examples=60)
def test_linear_keeps_measurements_and_stays_between_their_extremes(sparse):
    dense = linear_depth(sparse)
    depth, measured = dense.depth_m.numpy(), sparse > 0
    assert (depth[measured] == sparse[measured]).all()
    assert dense.valid.numpy()[measured].all()
    assert (dense.valid.numpy() == (depth > 0)).all()
    filled = depth[depth > 0]
    if len(filled):
        assert filled.min() >= sparse[measured].min() * (1 - 1e-6)
        assert filled.max() <= sparse[measured].max() * (1 + 1e-6)


@given(st.integers(0, 2**31))
@settings(max_examples=60)
def test_linear_is_linear_in_inverse_depth_in_a_triangle(seed):
    rng = np.random.default_rng(seed)
    corners = [tuple(corner) for corner in rng.integers(0, 12, (3, 2)).tolist()]
    (a, b), (c, d), (e, f) = corners
    if (c - a) * (f - b) == (d - b) * (e - a):
        return  # a line has its own test
    sparse = np.zeros((12, 12), np.float32)
    for corner in corners:
        sparse[corner] = rng.uniform(2, 50)
    inverse = [1 / float(sparse[corner]) for corner in corners]
    depth = linear_depth(sparse).depth_m.numpy()
    for y, x in np.ndindex(sparse.shape):
        expected = reference.in_triangle(corners, inverse, y, x)
        if expected is None:
            assert depth[y, x] == 0
        else:
            assert depth[y, x] == pytest.approx(1 / expected, rel=1e-5)


def test_linear_restores_a_plane_wherever_it_is_measured():
    truth = plane((40, 60), per_row=0.002, per_column=0.0005)
    sparse = np.where(random_map(0, truth.shape, 0.05) > 0, truth, np.float32(0))
    sparse[[0, 0, -1, -1], [0, -1, 0, -1]] = truth[[0, 0, -1, -1], [0, -1, 0, -1]]
    dense = linear_depth(sparse)
    assert dense.valid.all()
    np.testing.assert_allclose(dense.depth_m, truth, rtol=1e-5)


@pytest.mark.parametrize(
    "pixels", [[], [(3, 4)], [(3, 4), (5, 6)], [(1, 1), (3, 3), (7, 7)], [(2, 0), (2, 5), (2, 9)]]
)
def test_measurements_that_span_no_triangle_are_all_that_linear_gives(pixels):
    sparse = np.zeros((10, 10), np.float32)
    for pixel in pixels:
        sparse[pixel] = 8.0
    dense = linear_depth(sparse)
    assert (dense.depth_m.numpy() == sparse).all()
    assert (dense.valid.numpy() == (sparse > 0)).all()

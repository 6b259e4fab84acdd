from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from sightline.depth_completion.adaptive import (
    FIRST_EDITION,
    AdaptiveConfig,
    _nearest_true,
    adaptive_depth,
)
from sightline.depth_completion.adaptive_kernels import (
    bridge_rows,
    fill_columns,
    hidden_pixels,
    move_towards,
    right_neighbours,
    smooth_rows,
    trace_rings,
)
from sightline.depth_completion.classical import classical_depth
from tests.depth_completion.sparse_maps import plane, random_map, random_maps, rings
from tests.reference import adaptive_completion as reference

BEAMS = {64: 5, 32: 11, 16: 23, 8: 44}  # ring spacing in KITTI's images [rows]
WITHOUT_SMOOTHING = AdaptiveConfig(classical_share=0.0, softening=np.inf)
"""Settings without the steps that round contours: the median and morphological completion."""
MEAN = replace(WITHOUT_SMOOTHING, classical_share=0.5)
wide = pytest.mark.parametrize("row_spacing", BEAMS.values(), ids=BEAMS)


# properties of the method


@wide
def test_a_plane_comes_out_exactly_at_every_ring_spacing(row_spacing):
    truth = plane((180, 90), per_row=0.0008)
    dense = adaptive_depth(rings(truth, row_spacing=row_spacing), WITHOUT_SMOOTHING)
    between = slice(2, 2 + (177 // row_spacing) * row_spacing + 1)
    np.testing.assert_allclose(dense.depth_m[between], truth[between], rtol=1e-5)
    assert dense.valid[between, :-3].all()


@wide
def test_a_plane_that_also_turns_sideways_comes_out_within_a_hundredth(row_spacing):
    truth = plane((180, 90), per_row=0.0008, per_column=0.0002)
    dense = adaptive_depth(rings(truth, row_spacing=row_spacing), WITHOUT_SMOOTHING)
    between = slice(2, 2 + (177 // row_spacing) * row_spacing + 1)
    inner = slice(12, -12)  # at the border the mean of a row is one-sided
    np.testing.assert_allclose(dense.depth_m[between, inner], truth[between, inner], rtol=0.01)


def test_the_ground_goes_on_below_the_lowest_ring():
    truth = plane((120, 60), per_row=0.0008)
    sparse = rings(truth, row_spacing=20)
    sparse[90:] = 0  # the lowest ring is in row 82
    dense = adaptive_depth(sparse, WITHOUT_SMOOTHING)
    np.testing.assert_allclose(dense.depth_m[83:], truth[83:], rtol=1e-5)
    assert dense.valid[83:103, :-3].all()
    assert not dense.valid[103:].any()


def test_below_the_lowest_ring_the_ground_ends_after_twice_the_last_gap():
    truth = plane((120, 60), per_row=0.0008)
    sparse = rings(truth, row_spacing=20)
    sparse[30:] = 0  # rings in rows 2 and 22
    depth = adaptive_depth(sparse, WITHOUT_SMOOTHING).depth_m.numpy()
    np.testing.assert_allclose(depth[22:63], truth[22:63], rtol=1e-5)
    np.testing.assert_allclose(depth[63:], np.broadcast_to(truth[62], (57, 60)), rtol=1e-5)


def test_above_the_top_ring_its_depth_goes_on_and_only_a_ring_spacing_of_it_is_valid():
    sparse = rings(np.full((200, 60), 30.0, np.float32), row_spacing=10, first_row=100)
    dense = adaptive_depth(sparse, WITHOUT_SMOOTHING)
    np.testing.assert_allclose(dense.depth_m, 30.0, rtol=1e-5)
    assert dense.valid[90:190, :-3].all()
    assert not dense.valid[:90].any()


def test_above_a_top_ring_that_bends_its_depth_goes_on():
    sparse = np.zeros((60, 200), np.float32)
    columns = np.arange(200)
    bent = 30 - (columns - 100) ** 2 // 500  # rises by 20 rows at the sides, as KITTI's does
    for below in range(0, 30, 5):
        sparse[bent + below, columns] = np.where(np.abs(columns - 100) < 60, 50.0, 10.0)
    dense = adaptive_depth(sparse, WITHOUT_SMOOTHING)
    np.testing.assert_allclose(dense.depth_m[5:20, 80:120], 50.0, rtol=1e-5)


def test_a_hole_that_spans_many_rings_is_filled_but_not_valid():
    sparse = rings(np.full((200, 60), 30.0, np.float32), row_spacing=10)
    sparse[50:110, 20:40] = 0  # rows 42 and 112, columns 18 and 42 are measured around it
    dense = adaptive_depth(sparse, WITHOUT_SMOOTHING)
    np.testing.assert_allclose(dense.depth_m, 30.0, rtol=1e-5)
    assert not dense.valid[53:102, 19:42].any()
    assert dense.valid[53:102, :19].all()


@pytest.mark.parametrize("hidden", [slice(0, 120), slice(120, 200), slice(60, 140)])
def test_where_a_part_of_the_sweep_is_hidden_the_plane_beside_it_goes_on(hidden):
    depth = plane((200, 400), per_row=0.0005)
    sparse = rings(depth, row_spacing=5)
    sparse[hidden, 150:250] = 0
    dense = adaptive_depth(sparse, WITHOUT_SMOOTHING)
    measured_rows = slice(10, 190)
    error = np.abs(dense.depth_m.numpy() / depth - 1)[measured_rows]
    assert error.max() < 0.1  # just beyond a ring its depth goes on
    assert np.mean(error > 0.01) < 0.02
    middle = (hidden.start + hidden.stop) // 2
    assert not dense.valid[middle, 160:240].any()


@pytest.mark.parametrize("hidden_rows", [slice(0, 200), slice(60, 200)])
def test_a_road_of_which_the_sweep_shows_a_fifth_goes_on_where_rings_were(hidden_rows):
    depth = plane((200, 600), per_row=0.0005)
    sparse = rings(depth, row_spacing=5)
    sparse[hidden_rows, 60:540] = 0
    dense = adaptive_depth(sparse, WITHOUT_SMOOTHING)
    error = np.abs(dense.depth_m.numpy() / depth - 1)[80:190]
    assert error.max() < 0.1


def test_near_things_on_either_side_do_not_reach_across_what_no_ring_reaches():
    sparse = np.zeros((120, 300), np.float32)
    sparse[60::5] = 50.0
    for pole in (slice(5, 20), slice(280, 295)):
        sparse[20::5, pole] = 5.0
    dense = adaptive_depth(sparse, WITHOUT_SMOOTHING)
    np.testing.assert_allclose(dense.depth_m[25:55, 60:240], 50.0, rtol=1e-5)
    np.testing.assert_allclose(dense.depth_m[25:55, 8:17], 5.0, rtol=1e-5)


def test_a_far_measurement_between_near_ones_is_dropped_and_one_above_them_is_kept():
    sparse = np.zeros((60, 60), np.float32)
    sparse[20:50:5, ::3] = 6.0
    sparse[32, 30] = 40.0  # seen past an edge by the LiDAR, hidden from the camera
    sparse[10, ::3] = 40.0  # behind the top edge
    dense = adaptive_depth(sparse, WITHOUT_SMOOTHING)
    np.testing.assert_allclose(dense.depth_m[20:46], 6.0, rtol=1e-5)
    assert (dense.depth_m[10, ::3] == 40.0).all()


@wide
def test_a_far_measurement_is_dropped_wherever_it_lies_between_two_near_rings(row_spacing):
    sparse = rings(np.full((180, 60), 6.0, np.float32), row_spacing=row_spacing)
    sparse[2 + row_spacing + row_spacing // 2, 30] = 40.0
    np.testing.assert_allclose(adaptive_depth(sparse, WITHOUT_SMOOTHING).depth_m, 6.0, rtol=1e-5)


def test_a_gap_in_a_ring_is_not_bridged_by_way_of_the_ring_below():
    sparse = rings(np.full((60, 60), 10.0, np.float32), row_spacing=3)
    sparse[32] *= np.float32(1.1)  # another depth, to distinguish the rings
    sparse[29, 30:36] = 0  # the ring goes on after 9 columns, the one below after 3
    depth = adaptive_depth(sparse, WITHOUT_SMOOTHING).depth_m.numpy()
    np.testing.assert_allclose(depth[29], 10.0, rtol=1e-5)


@wide
def test_two_walls_side_by_side_keep_a_sharp_edge_on_the_rings(row_spacing):
    truth = np.full((180, 120), 8.0, np.float32)
    truth[:, 60:] = 30.0
    depth = adaptive_depth(rings(truth, row_spacing=row_spacing), WITHOUT_SMOOTHING).depth_m.numpy()
    on_ring = depth[2 + row_spacing]
    is_near, is_far = np.isclose(on_ring, 8.0, rtol=1e-6), np.isclose(on_ring, 30.0, rtol=1e-6)
    assert (is_near | is_far).all()
    assert abs(int(is_near.sum()) - 60) <= 2


def test_what_is_far_away_in_the_image_changes_nothing():
    truth = plane((100, 600), per_row=0.0008)
    sparse = rings(truth, row_spacing=10)
    other = sparse.copy()
    other[:, :200] *= np.float32(1.5)
    a, b = adaptive_depth(sparse, WITHOUT_SMOOTHING), adaptive_depth(other, WITHOUT_SMOOTHING)
    assert torch.equal(a.depth_m[:, 300:], b.depth_m[:, 300:])
    assert not torch.equal(a.depth_m[:, :200], b.depth_m[:, :200])


@given(random_maps(), st.sampled_from([0.25, 2.0, 1024.0]))
def test_the_first_edition_gives_depths_in_another_unit_the_same_map_in_that_unit(sparse, factor):
    dense = adaptive_depth(sparse, FIRST_EDITION)
    scaled = adaptive_depth(sparse * np.float32(factor), FIRST_EDITION)
    assert torch.equal(scaled.depth_m, dense.depth_m * factor)
    assert torch.equal(scaled.valid, dense.valid)


@given(random_maps())
def test_measurements_are_kept_or_hidden_by_nearer_ones_and_nothing_is_farther_than_all(sparse):
    depth = adaptive_depth(sparse, WITHOUT_SMOOTHING).depth_m.numpy()
    measured = sparse > 0
    if not measured.any():
        assert not depth.any()
        return
    changed = measured & (depth != sparse)
    assert (depth > 0).all()
    assert (sparse[changed] > 1.15 * sparse[measured].min()).all()
    assert depth.max() <= sparse.max() * (1 + 1e-5)


def test_a_column_without_measurements_takes_after_the_nearest_one_that_has_some():
    assert _nearest_true(np.array([0, 1, 0, 0, 1, 0, 0, 0], bool)).tolist() == [
        *(1, 1, 1, 4),
        *(4, 4, 4, 4),
    ]


@pytest.mark.parametrize(
    ("field", "value"), [("surface_ratio", 0.9), ("smoothing", -1.0), ("link_columns", np.inf)]
)
def test_a_setting_out_of_range_is_refused_by_name(field, value):
    with pytest.raises(ValueError, match=f"{field} must be at least"):
        AdaptiveConfig(**{field: value})


# single steps, against slow references


@given(random_maps(max_rows=10, max_columns=14), st.integers(1, 12), st.integers(1, 4))
def test_the_right_neighbour_is_the_first_one_on_the_ring(sparse, reach_columns, reach_rows):
    pixels = np.argwhere(sparse > 0)
    steps = right_neighbours(sparse, pixels, reach_columns, reach_rows)
    image = sparse.tolist()
    expected = [
        reference.right_neighbour(image, y, x, reach_columns, reach_rows)
        for y, x in pixels.tolist()
    ]
    assert [tuple(step) for step in steps.tolist()] == expected


reach = st.tuples(st.integers(0, 4), st.sampled_from([0.0, 1.5, 6.0]))


@given(random_maps(max_rows=12, max_columns=12, far_m=3.0), reach, reach, reach)
def test_a_pixel_is_hidden_by_nearer_ones_above_and_below_in_reach(sparse, above, below, columns):
    pixels = np.argwhere(sparse > 0)
    nearest_around = np.full_like(sparse, sparse.max())
    reaches = [tuple(map(float, each)) for each in (above, below, columns)]
    hidden = hidden_pixels(sparse, nearest_around, pixels, 1.25, *reaches)
    image = sparse.tolist()
    assert hidden.tolist() == [
        reference.is_hidden(image, y, x, 1.25, above, below, columns, float(sparse.max()))
        for y, x in pixels.tolist()
    ]


@pytest.mark.parametrize(
    ("right", "expected"),
    [(0.12, [0.1, 0.105, 0.11, 0.115, 0.12]), (0.4, [0.1, 0.1, 0.4, 0.4, 0.4])],
    ids=["on one surface", "from one surface to another"],
)
def test_a_ring_is_drawn_between_its_measurements_and_over_none(right, expected):
    measured = np.zeros((3, 5), np.float32)
    measured[0, 0], measured[2, 4] = 0.1, right
    measured[1, 2] = 0.01  # of another ring, behind the line
    pixels, steps = np.array([[0, 0]]), np.array([[4, 2]])
    traced = trace_rings(measured, pixels, steps, 1.25)
    on_line = traced[[0, 1, 1, 2, 2], range(5)]
    expected[2] = 0.01
    np.testing.assert_allclose(on_line, expected, rtol=1e-5)
    assert (traced > 0).sum() == 5


def test_where_two_lines_cross_the_nearer_one_stays():
    measured = np.zeros((3, 5), np.float32)
    measured[[0, 2], 0], measured[[0, 2], 4] = (0.1, 0.5), (0.5, 0.1)
    pixels, steps = np.array([[0, 0], [2, 0]]), np.array([[4, 2], [4, -2]])
    for order in ([0, 1], [1, 0]):
        traced = trace_rings(measured, pixels[order], steps[order], 1.25)
        assert traced[1, 2] == np.float32(0.5)


@given(
    random_maps(max_rows=20, max_columns=4),
    st.sampled_from([1.05, 4.0]),
    st.sampled_from([0.0, 2.0]),
    st.sampled_from([-1.0, 0.0, 0.7, 1.0]),
)
@settings(max_examples=200)
def test_columns_follow_surfaces_between_rings_level_above_and_the_ground_below(
    sparse, ratio, slope, share
):
    filled, distance, trusted = fill_columns(sparse, 6.0, 2.0, ratio, slope, share)
    for column in range(sparse.shape[1]):
        expected = reference.fill_column(sparse[:, column].tolist(), ratio, slope, share)
        if expected is None:
            assert not filled[:, column].any()
            assert not trusted[:, column].any()
            continue
        np.testing.assert_allclose(filled[:, column], expected[0], rtol=1e-5)
        assert distance[:, column].tolist() == expected[1]
        assert trusted[distance[:, column] <= 2, column].all()
        assert not trusted[distance[:, column] > 6, column].any()


@given(st.integers(0, 2**31), st.integers(1, 40))
def test_holes_are_linear_between_the_trusted_pixels_of_their_rows(seed, width):
    filled = random_map(seed, (3, width), 1.0)
    rng = np.random.default_rng(seed)
    trusted = rng.random(filled.shape) < rng.choice((0.1, 0.3))
    distance = rng.integers(0, 6, filled.shape).astype(np.float32)
    distance[:, rng.random(width) < 0.2] = np.inf  # columns without a ring
    bridged = bridge_rows(filled, distance, trusted, 2.0)
    for row in range(3):
        inputs = (filled[row], distance[row], trusted[row], distance[:row])
        expected = reference.bridge_row(*(values.tolist() for values in inputs), 2.0)
        np.testing.assert_allclose(bridged[row], expected, rtol=1e-5)


@given(st.integers(0, 2**31), st.integers(1, 40))
def test_rows_are_averaged_over_a_width_that_follows_the_distance(seed, width):
    depth = random_map(seed, (3, width), 1.0)
    distance = np.random.default_rng(seed).integers(0, 30, depth.shape).astype(np.float32)
    smooth = smooth_rows(depth, distance, 0.25)
    for row in range(3):
        expected = reference.smooth_row(depth[row].tolist(), distance[row].tolist(), 0.25)
        np.testing.assert_allclose(smooth[row], expected, rtol=1e-5)


# smoothing steps


def test_a_value_that_stands_out_of_its_surroundings_takes_their_median():
    sparse = rings(np.full((60, 60), 20.0, np.float32), row_spacing=5)
    sparse[32, 30] = 23.0
    hard = adaptive_depth(sparse, WITHOUT_SMOOTHING).depth_m
    soft = adaptive_depth(sparse, replace(WITHOUT_SMOOTHING, softening=0.01)).depth_m
    assert hard[32, 30] == soft[32, 30] == 23.0  # a measurement stays
    assert hard[31, 30] > 20.5
    np.testing.assert_allclose(soft[31, 30], 20.0, rtol=0.01)


def test_dense_rings_give_the_mean_with_morphology_where_both_differ_and_keep_measurements():
    truth = np.full((120, 120), 50.0, np.float32)
    truth[60:] = 20.0
    sparse = rings(truth, row_spacing=5)
    sparse[:30] = 0
    plain, mean = (adaptive_depth(sparse, config).depth_m for config in (WITHOUT_SMOOTHING, MEAN))
    filtered = classical_depth(sparse).depth_m
    differs = (filtered - plain).abs() > MEAN.classical_difference * plain
    is_mixed = torch.from_numpy(sparse == 0) & (filtered > 0) & differs
    is_mixed &= torch.tensor(reference.near_or_above(sparse.tolist(), reach=2))
    assert 100 < is_mixed.sum() < is_mixed.numel() / 2
    torch.testing.assert_close(mean[is_mixed], (plain + filtered)[is_mixed] / 2)
    assert torch.equal(mean[~is_mixed], plain[~is_mixed])


def test_where_rings_are_beyond_the_reach_of_its_kernels_morphology_has_no_share():
    truth = np.full((120, 120), 50.0, np.float32)
    truth[60:] = 20.0
    sparse = rings(truth, row_spacing=11)
    assert torch.equal(
        adaptive_depth(sparse, WITHOUT_SMOOTHING).depth_m, adaptive_depth(sparse, MEAN).depth_m
    )


@given(random_maps(max_rows=8), st.integers(0, 2**31), st.sampled_from([0.0, 0.03, 0.5]))
def test_depths_move_towards_others_that_differ_by_more_than_a_tolerance(depth, seed, tolerance):
    rng = np.random.default_rng(seed)
    other = rng.uniform(0, 60, depth.shape).astype(np.float32)
    is_selected = rng.random(depth.shape) < 0.5
    moved = move_towards(depth, other, is_selected, tolerance, 0.25)
    expected = [
        [
            a + 0.25 * (b - a) if is_moved and abs(b - a) > tolerance * a else a
            for a, b, is_moved in zip(*row, strict=True)
        ]
        for row in zip(depth.tolist(), other.tolist(), is_selected.tolist(), strict=True)
    ]
    np.testing.assert_allclose(moved, np.array(expected, np.float32), rtol=1e-5)


@pytest.mark.parametrize("row_spacing", [5, 11])
def test_between_two_surfaces_of_dense_rings_the_nearer_one_goes_on_for_most_of_the_gap(
    row_spacing,
):
    truth = np.full((100, 60), 40.0, np.float32)
    truth[40:] = 10.0
    depth = adaptive_depth(rings(truth, row_spacing=row_spacing), WITHOUT_SMOOTHING).depth_m.numpy()
    rows = range(
        2 + row_spacing * ((37) // row_spacing) + 1, 2 + row_spacing * (37 // row_spacing + 1)
    )
    values = depth[rows.start : rows.stop, 30]
    if row_spacing == 5:
        assert set(np.round(values, 3).tolist()) == {40.0, 10.0}
        assert (values < 11).sum() > (values > 39).sum()
    else:
        assert ((values > 10.5) & (values < 39)).all()

"""Depth and error maps as colours."""

import numpy as np
import pytest
import torch

from sightline.structures.predictions import DepthMap
from sightline.visualization.colors import DEPTH_SCALE, ERROR_SCALE, INVALID, UNCERTAINTY_SCALE
from sightline.visualization.depth import (
    GUESS_SHADE,
    MISSING,
    colorize_depth,
    colorize_error,
    draw_depth,
    put_legend,
)


def test_pixels_without_a_depth_are_dark():
    depth = torch.tensor([[0.0, -3.0, float("nan"), float("inf"), 10.0]])
    picture = colorize_depth(depth)
    assert (picture[0, :4] == INVALID).all()
    assert max(INVALID) < 30
    assert (picture[0, 4] == DEPTH_SCALE.colors(np.array([10.0]))[0]).all()


def brightness(rgb):
    """CIE lightness (L* of 1976) of colours in sRGB, 0 to 100; visible to colour-blind people."""
    linear = np.where(rgb <= 10, rgb / 255 / 12.92, ((rgb / 255 + 0.055) / 1.055) ** 2.4)
    luminance = linear @ np.array([0.2126, 0.7152, 0.0722])
    return 116 * np.cbrt(luminance) - 16


def test_near_is_bright_and_every_step_away_is_darker_by_the_same():
    steps = np.diff(brightness(DEPTH_SCALE.table[::8].astype(float)))
    assert (steps < 0).all()
    assert steps.min() > 2 * steps.mean()


def test_large_expected_errors_are_bright_and_every_step_counts():
    steps = np.diff(brightness(UNCERTAINTY_SCALE.table[::8].astype(float)))
    assert (steps > 0).all()


@pytest.mark.parametrize("scale", [DEPTH_SCALE, UNCERTAINTY_SCALE])
def test_no_value_of_a_scale_looks_like_a_hole(scale):
    assert brightness(scale.table.astype(float)).min() > brightness(np.array(INVALID, float)) + 15


def test_depths_beyond_the_scale_take_the_colour_of_its_end():
    picture = colorize_depth(torch.tensor([[0.1, 2.0, 80.0, 500.0]]))[0]
    assert (picture[0] == picture[1]).all()
    assert (picture[2] == picture[3]).all()


def test_a_single_measurement_grows_to_a_square_with_the_nearest_on_top():
    depth = torch.zeros(7, 9)
    depth[3, 3], depth[3, 5] = 40.0, 5.0
    picture = colorize_depth(depth, point_size_px=3)
    near = DEPTH_SCALE.colors(np.array([5.0]))[0]
    assert (picture[2:5, 4:7] == near).all()
    assert (picture[2:5, 2:4] == DEPTH_SCALE.colors(np.array([40.0]))[0]).all()
    assert np.count_nonzero((picture != INVALID).any(axis=2)) == 15


def test_an_error_is_orange_where_too_far_and_blue_where_too_near():
    truth = torch.tensor([[10.0, 10.0, 10.0, 10.0, 0.0]])
    predicted = torch.tensor([[13.0, 7.0, 10.0, 0.0, 10.0]])
    far, near, right, missing, unknown = colorize_error(predicted, truth)[0].astype(int)
    assert far[0] > far[2] + 80
    assert near[2] > near[0] + 80
    assert right.max() - right.min() < 10
    assert right.min() > 180
    assert tuple(missing) == MISSING
    assert tuple(unknown) == INVALID


def test_the_largest_error_stays_on_top_when_sparse_truth_grows():
    truth, predicted = torch.zeros(5, 5), torch.full((5, 5), 10.0)
    truth[2, 1], truth[2, 3] = 10.0, 14.0  # errors 0 and -4 m
    picture = colorize_error(predicted, truth, point_size_px=3)
    assert (picture[2, 2] == ERROR_SCALE.colors(np.array([-4.0]))[0]).all()


@pytest.mark.parametrize("scale", [DEPTH_SCALE, ERROR_SCALE, UNCERTAINTY_SCALE])
def test_positions_rise_from_0_to_1_and_ticks_lie_on_the_scale(scale):
    low = scale.lowest_m if scale.kind == "log" else -scale.highest_m
    positions = scale.positions(np.linspace(low, scale.highest_m, 500))
    assert (np.diff(positions) > 0).all()
    assert positions[0] == pytest.approx(0)
    assert positions[-1] == pytest.approx(1)
    assert scale.ticks_m[0] == pytest.approx(low)
    assert scale.ticks_m[-1] == pytest.approx(scale.highest_m)


def test_a_legend_shows_the_scale_from_left_to_right():
    canvas = np.zeros((40, 400, 3), np.uint8)
    put_legend(canvas, DEPTH_SCALE, right=360, top=5, width_px=256)
    assert (canvas[8, 104:360] == DEPTH_SCALE.table).all()
    assert canvas[14:].max() > 100


def test_a_legend_shows_what_a_hole_looks_like():
    plain, canvas = (np.full((40, 500, 3), 60, np.uint8) for _ in range(2))
    put_legend(plain, DEPTH_SCALE, right=460, top=5, width_px=256)
    put_legend(canvas, DEPTH_SCALE, right=460, top=5, width_px=256, hole="no value")
    assert (canvas[:, 204:] == plain[:, 204:]).all()
    left = canvas[:, :204]
    assert (left == INVALID).all(axis=2).sum() >= 50
    assert left.max() > 120


def test_guessed_depths_are_darker_and_distrusted_ones_are_not_drawn():
    depth_m = torch.full((1, 4), 10.0)
    depth = DepthMap(
        depth_m=depth_m,
        valid=torch.tensor([[True, False, False, True]]),
        guessed=torch.tensor([[False, True, False, False]]),
    )
    trusted, guessed, nothing, _ = draw_depth(depth)[0].astype(int)
    assert np.abs(trusted * GUESS_SHADE - guessed).max() <= 1
    assert tuple(nothing) == INVALID
    without = DepthMap(depth_m=depth_m, valid=depth.valid)
    assert tuple(draw_depth(without)[0, 1]) == INVALID

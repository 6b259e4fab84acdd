"""What a network sees of a sweep: range, view, number of points, and which far ones stay."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.augmentation.sample_changes import points_in_view
from sightline.detection3d.sweeps import SweepConfig, cut_to_view, draw_points, points_in_range
from tests.detection3d.frames import HIGH, LOW, simulated_frames


def row_of(near, far):
    """Points whose reflectance is their number; the far ones lie beyond 40 m."""
    x = torch.cat((torch.linspace(1, 39, near), torch.linspace(40, 70, far)))
    points = torch.zeros(near + far, 4)
    points[:, 0], points[:, 3] = x, torch.arange(near + far)
    return points


@given(
    near=st.integers(0, 30),
    far=st.integers(0, 30),
    num_points=st.integers(1, 40),
    seed=st.integers(0, 5),
)
def test_exactly_so_many_points_are_drawn_and_far_ones_before_near_ones(
    near, far, num_points, seed
):
    points = row_of(near, far)
    config = SweepConfig(num_points=num_points)
    numbers = draw_points(points, config, np.random.default_rng(seed))[:, 3].long().tolist()
    count = near + far
    if count == 0:
        assert numbers == []
        return
    assert len(numbers) == num_points
    if count <= num_points:
        assert set(numbers) == set(range(count))
        return
    assert len(set(numbers)) == num_points
    num_far = sum(number >= near for number in numbers)
    if far < num_points:
        assert num_far == far


def test_the_same_generator_draws_the_same_and_another_another_order():
    points, config = row_of(50, 10), SweepConfig(num_points=40)
    first, again, other = (
        draw_points(points, config, np.random.default_rng(seed)) for seed in (1, 1, 2)
    )
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def test_what_is_out_of_range_is_left_out_by_its_height_above_our_road():
    points = torch.tensor(
        [[0.0, 0, 0, 0], [-0.1, 0, 0, 0], [70.5, 0, 0, 0], [9, 41, 0, 0], [9, 0, -3.5, 0],
         [9, 0, 0.5, 0], [9, 0, 1.5, 0]]
    )  # fmt: skip
    config = SweepConfig(lowest_m=LOW, highest_m=HIGH)
    assert points_in_range(points, config).tolist() == points[[0, 5]].tolist()
    lifted = points_in_range(points, replace(config, height_offset_m=1.0))
    torch.testing.assert_close(lifted[:, 2], torch.tensor([1.0, -2.5]))


def test_points_beside_the_image_are_cut_off_where_asked_for():
    sample = simulated_frames()[0]
    is_in_view = points_in_view(sample)
    sample = replace(sample, points=torch.cat((sample.points[is_in_view], -sample.points[:10])))
    assert len(cut_to_view(sample, SweepConfig()).points) == int(is_in_view.sum())
    assert cut_to_view(sample, SweepConfig(in_view=False)) is sample


def test_points_that_are_not_finite_are_refused_in_one_line():
    sample = simulated_frames()[0]
    points = sample.points.clone()
    points[5, 1], points[9, 0] = torch.nan, torch.inf
    with pytest.raises(ValueError, match=r"000000 holds 2 points with NaN .* is point 5 of"):
        cut_to_view(replace(sample, points=points), SweepConfig())
    with pytest.raises(ValueError, match="000000 has no sweep"):
        cut_to_view(replace(sample, points=None), SweepConfig())


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"num_points": 0}, "num_points must be from 1"),
        ({"lowest_m": (0.0, 40.0, -3.0)}, "lowest_m must be below highest_m"),
        ({"far_m": torch.inf}, "must be within 100000"),
    ],
)
def test_settings_out_of_range_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        SweepConfig(**settings)

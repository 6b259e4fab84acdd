"""Pillars against a dictionary of lists."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.detection3d.pillars.config import PillarGridConfig
from sightline.detection3d.pillars.stage import pillar_features
from tests.reference import compact3d as reference

GRID = PillarGridConfig(
    x_m=(1.0, 5.0), y_m=(-4.0, 4.0), z_m=(-2.0, 2.0), cell_m=0.5, slices=4, lowest_slice_m=-1.0,
    slice_m=0.5, reflectance=True,
)  # fmt: skip
quarter = st.integers(-24, 24).map(lambda number: number / 4)  # on borders, and beyond
point = st.tuples(quarter, quarter, quarter, st.sampled_from([0.0, 0.25, 1.0]))


@pytest.mark.parametrize("local_window", [0, 1, 3, 5])
@given(points=st.lists(point, max_size=12))
def test_each_pillar_tells_what_a_dictionary_of_points_tells(local_window, points):
    grid = replace(GRID, local_window=local_window)
    maps = pillar_features(torch.tensor(points).reshape(-1, 4), grid)
    expected = torch.zeros(grid.rows, grid.columns, grid.channels)
    for (row, column), values in reference.pillar_features(points, grid).items():
        expected[row, column] = torch.tensor(values)
    torch.testing.assert_close(maps.permute(1, 2, 0), expected)


def test_the_order_of_points_does_not_matter_and_the_same_ones_give_the_same_bits():
    generator = torch.Generator().manual_seed(0)
    points = 4 * torch.rand(500, 4, generator=generator)
    shuffled = points[torch.randperm(500, generator=generator)]
    torch.testing.assert_close(pillar_features(shuffled, GRID), pillar_features(points, GRID))
    assert torch.equal(pillar_features(points, GRID), pillar_features(points, GRID))


def test_a_sweep_without_points_is_empty_ground_and_maps_lie_channels_last():
    maps = pillar_features(torch.zeros(0, 4), GRID)
    assert maps.shape == (GRID.channels, 8, 16)
    assert not maps.any()
    assert maps[None].is_contiguous(memory_format=torch.channels_last)


def test_without_reflectance_three_fields_are_enough():
    grid = PillarGridConfig()
    assert pillar_features(torch.ones(3, 3), grid).shape == (16, 352, 400)


def test_points_that_are_no_numbers_or_endless_lie_nowhere():
    bad = torch.tensor([[float("nan")] * 4, [float("inf"), 0, 0, 0], [2, 2, float("nan"), 0]])
    assert not pillar_features(bad, GRID).any()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"cell_m": 0.0}, "cell_m must be positive and finite, got 0"),
        ({"slices": 0}, "slices must be at least 1"),
        ({"local_window": 4}, "local_window must be 0 or odd and at most 15, got 4"),
        ({"z_m": (1.0, 1.0)}, "z_m must rise and lie within 100000, got 1.0 to 1.0"),
        ({"y_m": (-40.0, 1e9)}, "y_m must rise and lie within 100000, got -40.0 to 1000000000.0"),
        ({"lowest_slice_m": 1e9}, "lowest_slice_m must be from -100000 to 100000, got 1"),
        (
            {"cell_m": 1e-3},
            "the grid has 70400 x 80000 cells of 16 numbers, expected up to 67108864",
        ),
        ({"cell_m": 5e-324}, "the grid has inf x inf cells"),
        ({"slices": 10**9}, "the grid has 352 x 400 cells of 1000000006 numbers"),
        ({"x_m": (0.0, 70.0)}, "x_m must span a multiple of 8 cells of 0.2 m, got 0.0 to 70.0"),
    ],
)
def test_settings_out_of_range_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        PillarGridConfig(**wrong)

import itertools
import math
from functools import partial

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.sim_or_real import Verdicts, score
from benchmarks.sim_or_real_crops import CarCrop, match
from benchmarks.sim_or_real_judges import (
    PointJudge,
    area_under_curve,
    drawn_points,
    judge_by_features,
    judge_by_network,
    reflectance_features,
    shape_features,
)


def car(
    distance_m: float = 20.0,
    view_angle: float = 0.0,
    occlusion: int = 0,
    *,
    points: torch.Tensor | None = None,
) -> CarCrop:
    points = (
        torch.rand(40, 4, generator=torch.Generator().manual_seed(0)) if points is None else points
    )
    return CarCrop(
        frame=0,
        points=points,
        ranges_m=torch.full((len(points),), distance_m, dtype=torch.double),
        azimuths=torch.arange(len(points), dtype=torch.double) * 0.003,
        size_lwh=torch.tensor([4.0, 1.6, 1.5]),
        patch=None,
        distance_m=distance_m,
        view_angle=view_angle,
        occlusion=occlusion,
    )


def cost(one: CarCrop, other: CarCrop) -> float:
    turn = math.remainder(one.view_angle - other.view_angle, 2 * math.pi)
    apart = math.log(one.distance_m / other.distance_m)
    return (
        (apart / 0.1) ** 2 + (turn / math.radians(10)) ** 2 + 4 * (one.occlusion != other.occlusion)
    )


cars = st.lists(
    st.builds(car, st.floats(5, 50), st.floats(-7, 7), st.integers(0, 1)), min_size=2, max_size=4
)


@settings(deadline=None)
@given(real=cars, simulated=cars)
def test_cars_are_paired_so_that_distance_view_and_occlusion_differ_least(real, simulated):
    pairs = match(real, simulated)
    fewer, more = sorted((real, simulated), key=len)
    assert len({pair[0] for pair in pairs}) == len({pair[1] for pair in pairs}) == len(fewer)
    min_cost = min(
        sum(cost(*pair) for pair in zip(fewer, chosen, strict=True))
        for chosen in itertools.permutations(more, len(fewer))
    )
    assert sum(cost(real[one], simulated[other]) for one, other in pairs) == pytest.approx(min_cost)


def test_a_judge_that_always_says_the_same_is_right_half_the_time_whatever_there_is_more_of():
    is_real = np.array([True] * 30 + [False] * 10)
    verdicts = Verdicts(is_real=is_real, frames=np.arange(40) % 10, right=is_real)
    result = score([verdicts, verdicts])
    assert result["balanced_accuracy"] == result["low"] == result["high"] == 0.5


def test_the_interval_is_wider_where_the_items_of_a_frame_are_right_together():
    rng = np.random.default_rng(0)
    is_real, frames = np.arange(400) < 200, np.arange(400) % 20
    alone = Verdicts(is_real=is_real, frames=frames, right=rng.random(400) < 0.7)
    together = Verdicts(is_real=is_real, frames=frames, right=(rng.random(20) < 0.7)[frames])
    widths = [score([one, one])["high"] - score([one, one])["low"] for one in (alone, together)]
    assert widths[1] > 2 * widths[0] > 0


values = st.lists(st.integers(-3, 3), min_size=1, max_size=8)


@given(real=values, simulated=values)
def test_the_area_under_the_curve_counts_the_pairs_in_which_the_real_one_is_larger(real, simulated):
    wins = [1.0 if r > s else 0.5 if r == s else 0.0 for r in real for s in simulated]
    is_real = torch.tensor([True] * len(real) + [False] * len(simulated))
    area = area_under_curve(torch.tensor([*real, *simulated]).float(), is_real)
    assert area == pytest.approx(sum(wins) / len(wins))


@pytest.mark.parametrize(("shift", "low", "high"), [(0.0, 0.35, 0.65), (3.0, 0.9, 1.0)])
def test_features_part_what_differs_and_not_what_does_not(shift: float, low: float, high: float):
    generator = torch.Generator().manual_seed(1)
    is_real = torch.arange(200) < 100
    train, test = torch.randn(2, 200, 4, generator=generator)
    train[is_real, 2] += shift
    test[is_real, 2] += shift
    right = judge_by_features(train, is_real, test) == is_real
    assert low <= right.float().mean() <= high


def test_a_network_learns_from_the_points_what_parts_the_sides():
    torch.manual_seed(0)
    is_real = torch.arange(60) < 30
    train, test = torch.rand(2, 60, 64, 4)
    for items in (train, test):
        items[is_real, :, 3] *= 0.3
    judge = partial(judge_by_network, make=lambda _: PointJudge(4), steps=60)
    assert (judge(train, is_real, test) == is_real).float().mean() > 0.9


def test_networks_get_as_many_points_of_every_car_all_of_its_own():
    few, many = torch.rand(30, 4), torch.rand(900, 4)
    drawn = drawn_points([car(points=few), car(points=many)], seed=0)
    assert drawn.shape == (2, 256, 4)
    assert {tuple(point) for point in drawn[0].tolist()} == {tuple(p) for p in few.tolist()}
    assert len(drawn[1].unique(dim=0)) == 256


def test_features_of_a_car_say_how_many_shots_were_lost_and_how_much_is_black():
    points = torch.rand(40, 4)
    points[:30, 3] = 0.0
    whole = car(points=points)
    assert shape_features(whole)["skipped shots"] == 0
    assert reflectance_features(whole)["share of zeros"] == pytest.approx(0.75)
    kept = torch.arange(40) % 4 != 1  # every fourth shot is lost: a step of two in three
    torn = CarCrop(
        frame=0,
        points=points[kept],
        ranges_m=whole.ranges_m[kept],
        azimuths=whole.azimuths[kept],
        size_lwh=whole.size_lwh,
        patch=None,
        distance_m=20.0,
        view_angle=0.0,
        occlusion=0,
    )
    assert shape_features(torn)["skipped shots"] == pytest.approx(1 / 3, abs=0.02)

"""Bent ground and noisy ranges, point by point."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.augmentation.sweep_changes import (
    GroundShape,
    GroundShapeConfig,
    add_range_noise,
    bend_ground,
    draw_ground_shape,
    stretch_objects,
)
from tests.data.scenes import few, sample_of, seeds

slope = st.floats(-0.1, 0.1)


@few
@given(seed=seeds, height=st.floats(-1, 1), slopes=st.tuples(slope, slope), hill=slope)
def test_points_and_boxes_rise_by_what_their_place_says_and_nothing_else_moves(
    seed, height, slopes, hill
):
    sample = sample_of(seed)
    shape = GroundShape(
        height_m=height, slope_x=slopes[0], slope_y=slopes[1], curvature_per_m=hill / 100
    )
    bent = bend_ground(sample, shape)
    for given_row, row in zip(bent.points.tolist(), sample.points.tolist(), strict=True):
        rise = height + slopes[0] * row[0] + slopes[1] * row[1] + hill / 100 * row[0] ** 2
        assert given_row == pytest.approx([*row[:2], row[2] + rise, row[3]], abs=1e-4)
    expected = sample.objects.boxes3d.tensor.clone()
    x, y = expected[0, :2].tolist()
    expected[0, 2] += height + slopes[0] * x + slopes[1] * y + hill / 100 * x**2
    torch.testing.assert_close(bent.objects.boxes3d.tensor, expected)  # the row of zeros, too


def test_a_sample_without_sweep_or_labels_has_none_afterwards():
    bent = bend_ground(sample_of(points=None, objects=None), GroundShape(height_m=1.0))
    assert bent.points is None
    assert bent.objects is None


def test_shapes_are_drawn_as_wide_as_is_asked_for():
    rng, config = np.random.default_rng(0), GroundShapeConfig()
    drawn = [draw_ground_shape(config, rng) for _ in range(2000)]
    for name, mean in (("height_m", 0.05), ("slope_x", 0), ("slope_y", 0), ("curvature_per_m", 0)):
        values, deviation = [getattr(shape, name) for shape in drawn], getattr(config, name)
        assert np.std(values) == pytest.approx(deviation, rel=0.05)
        assert np.mean(values) == pytest.approx(mean, abs=deviation / 10)


@few
@given(seed=seeds)
def test_ranges_are_wrong_by_as_much_as_is_asked_for_and_rays_stay(seed):
    sample = sample_of(seed, num_points=3000)
    noisy = add_range_noise(sample, 0.1, np.random.default_rng(seed))
    old, new = sample.points.double(), noisy.points.double()
    error = new[:, :3].norm(dim=1) - old[:, :3].norm(dim=1)
    assert error.std().item() == pytest.approx(0.1, rel=0.1)
    assert error.mean().item() == pytest.approx(0, abs=0.01)
    cosine = torch.cosine_similarity(new[:, :3], old[:, :3])
    torch.testing.assert_close(cosine, torch.ones_like(cosine))
    assert torch.equal(new[:, 3], old[:, 3])


def test_a_point_at_the_sensor_stays_and_none_is_moved_beyond_it():
    near = torch.tensor([[0.0, 0, 0, 0.5], [0.01, 0, 0, 0.5]]).repeat(100, 1)
    noisy = add_range_noise(sample_of(points=near), 5.0, np.random.default_rng(0)).points
    assert not noisy[::2, :3].any()
    assert (noisy[1::2, 0] >= 0).all()
    assert (noisy[1::2, 0] == 0).any()


def test_what_cannot_be_done_is_refused():
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="deviation_m must be finite and not negative, got -1"):
        add_range_noise(sample_of(), -1.0, rng)
    with pytest.raises(ValueError, match="sample random 0 has no sweep to change; give it points"):
        add_range_noise(sample_of(points=None), 0.1, rng)
    with pytest.raises(ValueError, match="the ground's shape needs finite numbers, got Ground"):
        GroundShape(slope_x=math.nan)
    with pytest.raises(ValueError, match="slope_y must be finite and not negative, got -1"):
        GroundShapeConfig(slope_y=-1.0)


factor = st.floats(0.5, 2.0)


@few
@given(seed=seeds, size_factors=st.tuples(factor, factor, factor))
def test_points_of_a_stretched_object_keep_their_place_in_its_box(seed, size_factors):
    sample = sample_of(seed)
    box = sample.objects.boxes3d.tensor[0]
    inside = box[:3] + 0.4 * box[3:6].min() * torch.rand(5, 3).double()
    sample = replace(sample, points=torch.cat((sample.points, with_reflectance(inside))))
    factors = torch.tensor([size_factors] * len(sample.objects), dtype=torch.float64)
    stretched = stretch_objects(sample, factors)
    longer = stretched.objects.boxes3d.tensor[0]
    for row, given_row in zip(stretched.points.tolist(), sample.points.tolist(), strict=True):
        before, after = place_in(box.tolist(), given_row), place_in(longer.tolist(), row)
        if all(abs(value) < 0.5 for value in before[:2]) and 0 < before[2] < 1:
            assert after == pytest.approx(before, abs=1e-4)
            assert row[3] == given_row[3]
        elif all(abs(value) > 0.501 for value in before[:2]) and not -0.001 < before[2] < 1.001:
            assert row == given_row
    torch.testing.assert_close(longer[3:6], box[3:6] * factors[0])
    assert longer[2] - longer[5] / 2 == pytest.approx(float(box[2] - box[5] / 2))
    assert torch.equal(stretched.objects.boxes3d.tensor[-1], sample.objects.boxes3d.tensor[-1])


def place_in(box, point):
    """Position in a box: shares of length and width from the middle, of height from below."""
    x, y, z, length, width, height, yaw = box
    dx, dy = point[0] - x, point[1] - y
    along = math.cos(yaw) * dx + math.sin(yaw) * dy
    across = math.cos(yaw) * dy - math.sin(yaw) * dx
    return [along / length, across / width, (point[2] - z) / height + 0.5]


def with_reflectance(places):
    return torch.cat((places, torch.full((len(places), 1), 0.5)), dim=1).float()


def test_objects_are_stretched_by_positive_factors_and_with_their_points():
    sample = sample_of(0)
    factors = torch.ones(len(sample.objects), 3, dtype=torch.float64)
    with pytest.raises(ValueError, match="positive and finite"):
        stretch_objects(sample, 0 * factors)
    with pytest.raises(ValueError, match="has no sweep or no labels"):
        stretch_objects(replace(sample, points=None), factors)

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given

from sightline.augmentation.sample_changes import ColorJitterConfig, crop, drop_camera, jitter_color
from tests.data.scenes import SIZE, few, sample_of, seeds


def jittered(sample, seed=0, **spreads):
    nothing = {"brightness": 0.0, "contrast": 0.0, "gamma": 0.0, "saturation": 0.0}
    config = ColorJitterConfig(**{**nothing, **spreads})
    return jitter_color(sample, rng=np.random.default_rng(seed), config=config).image


def test_no_spread_leaves_the_image_as_it_is():
    sample = sample_of()
    assert torch.equal(jittered(sample), sample.image)


@few
@given(seeds)
def test_brightness_scales_all_values_by_one_factor_within_its_spread(seed):
    sample = sample_of(image=torch.arange(256, dtype=torch.uint8).repeat(3, 120, 2)[..., :400])
    image = jittered(sample, seed, brightness=0.5).double()
    factor = (image[0, 0, 100] / 100).item()
    assert 1 / 1.5 - 0.01 <= factor <= 1.5 + 0.01
    torch.testing.assert_close(
        image, (sample.image * factor).clamp(max=255).double(), rtol=0, atol=1.8
    )


@few
@given(seeds)
def test_gamma_keeps_black_white_and_the_order_of_the_values(seed):
    sample = sample_of(image=torch.arange(256, dtype=torch.uint8).repeat(3, 120, 2)[..., :400])
    row = jittered(sample, seed, gamma=0.5)[0, 0, :256].int()
    assert (row[0].item(), row[255].item()) == (0, 255)
    assert (row.diff() >= 0).all()


@few
@given(seeds)
def test_contrast_keeps_the_mean_level(seed):
    grey = np.random.default_rng(seed).integers(100, 150, SIZE, dtype=np.uint8)
    sample = sample_of(image=torch.from_numpy(np.stack([grey] * 3)))
    image = jittered(sample, seed, contrast=0.5).double()
    assert image.mean().item() == pytest.approx(grey.mean(), abs=0.6)
    assert 1 / 1.55 < image.std().item() / grey.std() < 1.55


@few
@given(seeds)
def test_saturation_leaves_grey_alone_and_moves_colours_along_their_distance_to_grey(seed):
    sample = sample_of(seed)
    sample = replace(sample, image=sample.image // 4 + 96)  # nothing is clipped
    image = jittered(sample, seed, saturation=0.5).double()
    before = sample.image.double()
    spread = [one.amax(dim=0) - one.amin(dim=0) for one in (before, image)]
    colourful = spread[0] > 30
    factors = (spread[1] / spread[0])[colourful]
    assert 1 / 1.5 - 0.05 < factors.min() <= factors.max() < 1.5 + 0.05
    assert factors.max() - factors.min() < 0.08  # rounding of 30 levels
    grey = replace(sample, image=sample.image[:1].repeat(3, 1, 1))
    assert torch.equal(jittered(grey, seed, saturation=0.5), grey.image)


@few
@given(seeds)
def test_a_turned_hue_keeps_grey_the_largest_and_the_smallest_value(seed):
    sample = sample_of(seed)
    image = jittered(sample, seed, hue_deg=180.0).int()
    before = sample.image.int()
    assert (image != before).any()
    assert (image.amax(dim=0) == before.amax(dim=0)).all()
    assert (image.amin(dim=0) - before.amin(dim=0)).abs().max() <= 2  # of 8-bit saturations
    grey = replace(sample, image=sample.image[:1].repeat(3, 1, 1))
    assert torch.equal(jittered(grey, seed, hue_deg=180.0), grey.image)


@pytest.mark.parametrize(("hue_deg", "numbers"), [(0.0, 4), (90.0, 5)])
def test_only_a_hue_takes_a_fifth_number(hue_deg, numbers):
    used, expected = np.random.default_rng(1), np.random.default_rng(1)
    jitter_color(sample_of(), used, ColorJitterConfig(hue_deg=hue_deg))
    expected.uniform(size=numbers)
    assert used.random() == expected.random()


def test_colours_change_by_seed_and_the_given_image_stays():
    sample = sample_of()
    before = sample.image.clone()
    images = [jitter_color(sample, rng=np.random.default_rng(seed)).image for seed in (1, 1, 2)]
    assert torch.equal(images[0], images[1])
    assert not torch.equal(images[0], images[2])
    assert torch.equal(sample.image, before)


def test_a_view_of_an_image_can_be_jittered_and_a_missing_one_draws_the_same_numbers():
    part = crop(sample_of(), top=3, left=5, height=50, width=70)
    rng, other = np.random.default_rng(0), np.random.default_rng(0)
    assert jitter_color(part, rng=rng).image.shape == (3, 50, 70)
    assert jitter_color(drop_camera(part), rng=other).image is None
    assert rng.random() == other.random()


@pytest.mark.parametrize("name", ["brightness", "contrast", "gamma", "saturation"])
def test_a_negative_spread_is_refused(name):
    with pytest.raises(ValueError, match=f"{name} must be finite and not negative, got -0.1"):
        ColorJitterConfig(**{name: -0.1})

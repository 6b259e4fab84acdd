import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.corruptions.noise import (
    CameraDeadPixels,
    CameraGaussianNoise,
    add_gaussian_noise,
    draw_pixels,
)
from tests.data.scenes import SIZE, few, sample_of, seeds
from tests.reference import corruptions as reference


@few
@given(seed=seeds, sigma=st.floats(0, 255))
def test_noise_is_added_as_loops_say(seed, sigma):
    image = np.random.default_rng(seed).integers(0, 256, (3, 6, 9), dtype=np.uint8)
    found = add_gaussian_noise(torch.from_numpy(image), sigma, np.random.default_rng(seed))
    normal = np.random.default_rng(seed).standard_normal(image.shape, dtype=np.float32)
    assert found.tolist() == reference.noisy_image(image.tolist(), sigma, normal)


@pytest.mark.parametrize("sigma", [5.0, 20.0])
def test_noise_on_grey_has_the_deviation_asked_for_and_no_pattern(sigma):
    grey = torch.full((3, 200, 300), 128, dtype=torch.uint8)
    noise = add_gaussian_noise(grey, sigma, np.random.default_rng(0)).double() - 128
    assert noise.std().item() == pytest.approx(sigma, rel=0.01)
    assert noise.mean().item() == pytest.approx(0, abs=0.05 * sigma)
    flat = noise.reshape(3, -1)
    between_channels = torch.corrcoef(flat)[~torch.eye(3, dtype=torch.bool)]
    between_neighbours = torch.corrcoef(torch.stack((flat[0, :-1], flat[0, 1:])))[0, 1]
    assert torch.cat((between_channels, between_neighbours[None])).abs().max() < 0.02


def test_the_deviation_is_drawn_evenly_and_recorded():
    sample = sample_of(image=torch.full((3, *SIZE), 128, dtype=torch.uint8))
    noise = CameraGaussianNoise(sigma_levels=(2.0, 12.0))
    drawn = []
    for seed in range(100):
        found = noise.corrupt(sample, np.random.default_rng(seed))
        assert found.camera_mask.all()
        sigma = found.record.parameters["sigma_levels"]
        assert found.sample.image.double().std().item() == pytest.approx(sigma, rel=0.03)
        drawn.append(sigma)
    counts, _ = np.histogram(drawn, bins=4, range=(2, 12))
    assert counts.sum() == 100
    assert counts.min() >= 12


def test_by_default_the_deviation_is_drawn_from_20_to_120_levels():
    sample = sample_of(image=torch.zeros(3, 1, 1, dtype=torch.uint8), image_size=(1, 1), depth=None)
    noise = CameraGaussianNoise()
    rng = np.random.default_rng(0)
    drawn = [noise.corrupt(sample, rng).record.parameters["sigma_levels"] for _ in range(1000)]
    assert 20 <= min(drawn) < 21
    assert 119 < max(drawn) <= 120


@given(size=st.sampled_from([(1, 1), (5, 7), (12, 40)]), share=st.floats(0, 1), seed=seeds)
def test_exactly_the_rounded_share_of_the_pixels_is_drawn(size, share, seed):
    mask = draw_pixels(size, share, np.random.default_rng(seed))
    assert mask.shape == size
    assert mask.sum() == round(share * size[0] * size[1])


def test_each_pixel_is_as_likely_as_any_other():
    rng = np.random.default_rng(0)
    counts = torch.stack([draw_pixels((4, 5), 0.3, rng) for _ in range(3000)]).double().mean(dim=0)
    assert torch.allclose(counts, torch.tensor(0.3).double(), atol=0.04)


@few
@given(seed=seeds)
def test_dead_pixels_are_black_in_all_channels_and_the_others_as_they_were(seed):
    sample = sample_of(seed)
    bright = sample_of(seed, image=sample.image.clamp(min=1))
    found = CameraDeadPixels(share=(0.63, 0.63)).corrupt(bright, np.random.default_rng(seed))
    dead = found.camera_mask
    assert found.record.parameters == {"share": 0.63}
    assert dead.sum() == round(0.63 * SIZE[0] * SIZE[1])
    assert torch.equal(found.sample.image, torch.where(dead, 0, bright.image))
    assert torch.equal((found.sample.image != bright.image).any(dim=0), dead)

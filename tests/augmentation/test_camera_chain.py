from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.augmentation.camera_chain import (
    CameraChainConfig,
    change_camera,
    expose,
    split_colors,
)
from sightline.data.open import open_dataset
from sightline.simulation.packaged import PACKAGED_FRAMES

NOTHING = CameraChainConfig(share=1.0, chromatic_px=0.0, blur_px=0.0, balance=0.0, noise_levels=0.0)


@pytest.fixture(scope="module")
def sample():
    return open_dataset(PACKAGED_FRAMES, parts={"image"})[0]


def changed(sample, config, seed=0):
    return change_camera(sample, np.random.default_rng(seed), config).image


def test_the_same_camera_takes_the_same_picture(sample):
    assert torch.equal(changed(sample, NOTHING), sample.image)
    never = CameraChainConfig(share=0.0)
    assert changed(sample, never) is sample.image


def test_pictures_are_changed_as_often_as_is_said(sample):
    small = replace(sample, image=sample.image[:, :32, :64], image_size=(32, 64))
    config = CameraChainConfig(share=0.3)
    count = sum(changed(small, config, seed) is not small.image for seed in range(200))
    assert 40 < count < 80


def test_another_camera_shows_the_same_scene(sample):
    image = sample.image.float()
    for seed in range(5):
        other = changed(sample, CameraChainConfig(share=1.0), seed)
        assert other.shape == sample.image.shape
        assert other.dtype == torch.uint8
        coarse = [
            torch.nn.functional.avg_pool2d(each.float(), 16).flatten() for each in (image, other)
        ]
        assert torch.corrcoef(torch.stack(coarse))[0, 1] > 0.99
    assert changed(replace(sample, image=None), CameraChainConfig(share=1.0)) is None


@given(
    red_px=st.floats(-1.5, 1.5),
    blue_px=st.floats(-1.5, 1.5),
    x=st.integers(20, 180),
    y=st.integers(10, 90),
)
def test_colours_part_with_the_distance_from_the_middle(red_px, blue_px, x, y):
    spot = np.zeros((101, 201, 3), np.float32)
    spot[y, x] = 255
    image = cv2.GaussianBlur(spot, (0, 0), 2.0)
    image = (image / image.max() * 255).astype(np.uint8)
    parted = split_colors(image, red_px, blue_px).astype(np.float64)
    rows, columns = np.mgrid[:101, :201]
    for channel, shift_px in ((0, red_px), (1, 0.0), (2, blue_px)):
        light = parted[..., channel]
        middle = np.array([(light * each).sum() / light.sum() for each in (columns, rows)])
        expected = np.array([100, 50]) + (1 + shift_px / 100) * (np.array([x, y]) - [100, 50])
        np.testing.assert_allclose(middle, expected, atol=0.1)


@pytest.mark.parametrize("level", [0, 64, 255])
def test_noise_grows_with_the_root_of_the_light(level):
    image = np.full((200, 200, 3), level, np.uint8)
    noisy = expose(image, np.ones(3), 8.0, np.random.default_rng(1)).astype(float)
    deviation = 8 * np.sqrt(0.25 + 0.75 * level / 255)
    expected = np.clip(np.random.default_rng(2).normal(level, deviation, 10**6).round(), 0, 255)
    assert noisy.mean() == pytest.approx(expected.mean(), abs=0.1)
    assert noisy.std() == pytest.approx(expected.std(), rel=0.02)


def test_each_colour_has_its_gain():
    image = np.full((2, 2, 3), 100, np.uint8)
    bright = expose(image, np.array([0.5, 1.0, 3.0]), 0.0, np.random.default_rng(0))
    assert bright[0, 0].tolist() == [50, 100, 255]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"share": 1.5}, "share must be from 0 to 1, got 1.5"),
        ({"blur_px": -1.0}, "blur_px must be finite and not negative, got -1.0"),
        ({"noise_levels": float("nan")}, "noise_levels must be finite and not negative, got nan"),
    ],
)
def test_cameras_that_cannot_be_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        CameraChainConfig(**settings)

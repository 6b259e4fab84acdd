"""Image sensor: radiance to bytes."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sightline.simulation.camera.camera import SensorConfig, sensor_image
from tests.simulation.camera.scenes import QUIET

SHARP = QUIET.sensor


def taken(radiance, *, config=SHARP, exposure=1.0, seed=0):
    return sensor_image(
        np.asarray(radiance, np.float32),
        exposure,
        rng=np.random.default_rng(seed),
        config=config,
    )


def even(level, size=(40, 60)):
    return np.full((*size, 3), level, np.float32)


@given(level=st.floats(0.0, 3.0), more=st.floats(0.02, 1.0))
@settings(max_examples=30)
def test_more_light_is_never_darker_and_grey_stays_grey(level, more):
    low, high = taken(even(level)), taken(even(level + more))
    assert (low == low[0, 0, 0]).all()
    assert high[0, 0, 0] > low[0, 0, 0] or low[0, 0, 0] == 255
    assert (low[0, 0, 0] == 255) == (level > 0.995)


def test_no_light_is_black_and_too_much_is_white():
    assert (taken(even(0.0)) == 0).all()
    assert (taken(even(50.0)) == 255).all()


def test_colours_come_through_the_mosaic():
    radiance = np.broadcast_to(np.float32([0.8, 0.3, 0.05]), (40, 60, 3))
    image = taken(radiance)
    assert (image.reshape(-1, 3).std(axis=0) == 0).all()
    red, green, blue = (int(value) for value in image[0, 0])
    assert red > green > blue


def test_the_mosaic_keeps_sides_apart():
    """Red left, blue right: no channel is swapped or mirrored."""
    radiance = even(0.0)
    radiance[:, :30, 0] = 0.6
    radiance[:, 30:, 2] = 0.6
    image = taken(radiance)
    assert image[5:-5, 5:25].mean(axis=(0, 1)).argmax() == 0
    assert image[5:-5, 35:55].mean(axis=(0, 1)).argmax() == 2


def test_noise_grows_with_light_and_is_strongest_in_blue():
    noisy = replace(SHARP, photon_noise=0.02, read_noise=0.002, gamma=1.0)
    spread = [
        taken(even(level, (200, 200)), config=noisy).std(axis=(0, 1)) for level in (0.02, 0.5)
    ]
    assert (spread[1] > 2 * spread[0]).all()
    assert spread[1][2] > spread[1][1]


def test_noise_is_that_of_the_seed():
    noisy = replace(SHARP, photon_noise=0.02)
    first, again, other = (taken(even(0.3), config=noisy, seed=seed) for seed in (0, 0, 1))
    np.testing.assert_array_equal(first, again)
    assert (first != other).mean() > 0.3


def test_the_lens_darkens_corners_and_blurs_edges():
    vignetted = taken(even(0.5, (100, 300)), config=replace(SHARP, vignette=0.3))
    assert vignetted[0, 0, 1] < 0.85 * vignetted[50, 150, 1]
    step = even(0.0)
    step[:, 30:] = 0.8
    for blur in ("lens_blur_px", "resampling_blur_px"):
        blurred = taken(step, config=replace(SHARP, **{blur: 0.8}))[20, :, 1].astype(int)
        sharp = taken(step)[20, :, 1].astype(int)
        assert np.abs(np.diff(blurred)).max() < 0.9 * np.abs(np.diff(sharp)).max()


@given(exposure=st.floats(0.2, 4.0))
@settings(max_examples=15)
def test_full_metering_makes_up_for_any_exposure(exposure):
    radiance = np.random.default_rng(3).uniform(0.01, 0.2, size=(40, 60, 3))
    metered = replace(SHARP, metering=1.0, metering_limit=100.0)
    first = taken(radiance, config=metered).astype(int)
    other = taken(radiance, config=metered, exposure=exposure).astype(int)
    assert np.abs(first - other).max() <= 1
    assert first.mean() > 30


def test_metering_stays_within_its_limit():
    radiance = even(0.01)
    limited = replace(SHARP, metering=1.0, metering_limit=3.0)
    np.testing.assert_array_equal(
        taken(radiance, config=limited), taken(radiance, config=SHARP, exposure=3.0)
    )


def test_a_brighter_sky_does_not_darken_the_street():
    metered = replace(SHARP, metering=1.0, metering_limit=100.0)
    dull = even(0.1, (100, 60))
    bright = dull.copy()
    bright[:40] = 0.9
    street = slice(45, None)
    np.testing.assert_array_equal(
        taken(dull, config=metered)[street], taken(bright, config=metered)[street]
    )


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ({"gamma": 0.0}, "gamma must be finite and positive, got 0.0"),
        ({"metering_limit": 0.5}, "metering_limit must be finite and at least 1, got 0.5"),
        ({"photon_noise": -0.1}, "photon_noise must be finite and at least 0, got -0.1"),
        ({"lens_blur_px": -1.0}, "lens_blur_px must be finite and at least 0, got -1"),
    ],
)
def test_a_sensor_that_cannot_be_is_named(choice, message):
    with pytest.raises(ValueError, match=message):
        SensorConfig(**choice)

"""Radiance of the sky, and its light on surfaces."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sightline.simulation.camera.shading import daylight, sky_radiance, smooth_sky
from tests.simulation.camera.scenes import DAY, DUSK, EVEN

OVERCAST = replace(DAY, sun_color=(0.0, 0.0, 0.0), cloud_cover=1.0)
directions = (
    st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-1, 1))
    .filter(lambda way: np.linalg.norm(way) > 1e-3)
    .map(lambda way: tuple(float(value) for value in np.array(way) / np.linalg.norm(way)))
)


@given(way=directions, light=st.sampled_from([DAY, DUSK, EVEN, OVERCAST]))
def test_the_sky_is_bright_and_finite_everywhere(way, light):
    sky = daylight(light)
    for radiance in (sky_radiance(sky, *way), smooth_sky(sky, way[2])):
        assert np.isfinite(radiance).all()
        assert min(radiance) > 0


@given(way=directions)
def test_an_even_sky_is_one_everywhere_above_the_horizon(way):
    sky = daylight(EVEN)
    up = abs(way[2])
    assert sky_radiance(sky, way[0], way[1], up) == pytest.approx((1.0, 1.0, 1.0))
    assert smooth_sky(sky, up) == pytest.approx((1.0, 1.0, 1.0))


def test_a_clear_sky_runs_from_the_horizon_to_the_zenith():
    sky = daylight(replace(DAY, cloud_cover=0.0, sun_color=(0.0, 0.0, 0.0)))
    assert sky_radiance(sky, 1.0, 0.0, 0.0) == pytest.approx(DAY.sky_horizon)
    assert sky_radiance(sky, 0.0, 0.0, 1.0) == pytest.approx(DAY.sky_zenith)


def test_the_sky_is_brightest_at_the_sun():
    sky = daylight(DAY)
    sun = np.array(DAY.sun_direction)
    at_sun = sky_radiance(sky, *(float(value) for value in sun))
    rng = np.random.default_rng(0)
    for _ in range(50):
        way = sun + rng.normal(size=3)
        way /= np.linalg.norm(way)
        if way @ sun < 0.99:
            assert max(sky_radiance(sky, *(float(value) for value in way))) < max(at_sun)


def test_clouds_are_grey_and_more_of_them_hide_more_of_the_blue():
    rng = np.random.default_rng(0)
    ways = rng.normal(size=(400, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    ways[:, 2] = np.abs(ways[:, 2])

    def blueness(cover):
        sky = daylight(replace(OVERCAST, cloud_cover=cover))
        colors = np.array([sky_radiance(sky, *map(float, way)) for way in ways])
        return (colors[:, 2] / colors[:, 0]).mean()

    blue = [blueness(cover) for cover in (0.0, 0.3, 0.6, 1.0)]
    assert blue == sorted(blue, reverse=True)
    assert blue[-1] == pytest.approx(1.02, abs=0.1)


def test_clouds_belong_to_the_light_and_differ_between_lights():
    way = (0.6, 0.0, 0.8)
    turned = replace(DAY, sun_direction=(-0.48, 0.36, 0.8))
    assert sky_radiance(daylight(DAY), *way) == sky_radiance(daylight(DAY), *way)
    assert daylight(DAY).seed != daylight(turned).seed


def test_lamps_are_off_by_day_and_as_bright_at_every_exposure_in_the_dark():
    assert daylight(DAY).lamps == 0.0
    assert daylight(EVEN).lamps == 0.0
    for exposure in (0.5, 4.0):
        dark = daylight(replace(DUSK, exposure=exposure))
        assert dark.lamps * exposure == pytest.approx(1.0)

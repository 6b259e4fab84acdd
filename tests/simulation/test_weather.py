"""Sun and sky."""

import numpy as np
import pytest

from sightline.simulation.street import draw_light

LIGHTS = [draw_light(np.random.default_rng(seed)) for seed in range(300)]


def test_sun_directions_have_unit_length_and_the_sun_is_up_where_it_shines():
    for light in LIGHTS:
        assert np.linalg.norm(light.sun_direction) == pytest.approx(1.0)
        if max(light.sun_color) > 0:
            assert light.sun_direction[2] > 0.1


def test_clear_days_low_sun_overcast_and_dusk_all_occur_and_days_are_most():
    shining = [light for light in LIGHTS if max(light.sun_color) > 0]
    high = [light for light in shining if light.sun_direction[2] > np.sin(np.radians(20))]
    overcast = [light for light in LIGHTS if light.cloud_cover > 0.85]
    dusk = [light for light in LIGHTS if max(light.sky_zenith) < 0.4]
    assert len(high) > 0.5 * len(LIGHTS)
    assert len(shining) > len(high)
    assert 0 < len(dusk) < len(overcast) < 0.3 * len(LIGHTS)


def test_exposure_makes_grey_ground_about_equally_bright_in_all_weathers():
    """Exposed level of a grey of 0.18 under open sun and sky."""
    values = []
    for light in LIGHTS:
        sky = (np.mean(light.sky_zenith) + np.mean(light.sky_horizon)) / 2
        sun = np.mean(light.sun_color) * max(light.sun_direction[2], 0.0) / np.pi
        values.append(0.18 * (sky + sun) * light.exposure)
    assert np.max(values) / np.min(values) < 4.0

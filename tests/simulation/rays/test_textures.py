"""Procedural textures: bounded, repeatable, true to the colour of the face, calm from afar."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from sightline.simulation.rays.kernels import (
    Spot,
    clouded,
    crack,
    grid_lines,
    hashed,
    in_bond,
    lines,
    off_center,
    per_tile,
    speckle,
    value_noise,
)
from sightline.simulation.rays.textures import textured
from sightline.simulation.scene import Material
from tests.reference import shading as reference

share = st.floats(0.0, 1.0)
colors = st.tuples(share, share, share)
spots = st.builds(
    Spot,
    u=st.floats(-500, 500),
    v=st.floats(-500, 500),
    width_u=st.floats(0.0, 5.0),
    width_v=st.floats(0.0, 5.0),
    seed=st.integers(0, 2**31),
)
SMOOTH = (Material.WINDOW, Material.COATED_GLASS)
materials = st.sampled_from(list(Material))


@given(material=materials, color=colors, spot=spots)
def test_a_texture_stays_between_black_and_white_and_repeats(material, color, spot):
    surface = textured(int(material), color, spot)
    assert all(0.0 <= value <= 1.0 for value in surface.color)
    assert abs(surface.tilt_u) < 2.0
    assert abs(surface.tilt_v) < 2.0
    assert textured(int(material), color, spot) == surface


def looks(material, color, width, count=600, seed=3):
    rng = np.random.default_rng(5)
    places = rng.uniform(0, 200, size=(count, 2))
    return np.array(
        [
            textured(int(material), color, Spot(float(u), float(v), width, width, seed)).color
            for u, v in places
        ]
    )


@pytest.mark.parametrize("material", list(Material))
def test_a_texture_keeps_about_the_brightness_of_its_face(material):
    mean = looks(material, (0.2, 0.2, 0.2), 0.02).mean()
    assert 0.7 * 0.2 < mean < 1.35 * 0.2


@pytest.mark.parametrize("material", [m for m in Material if m not in (*SMOOTH, Material.LEAF)])
def test_a_texture_fades_where_a_pixel_spans_much_of_the_surface(material):
    near, far = (looks(material, (0.2, 0.2, 0.2), width)[:, 1].std() for width in (0.005, 30.0))
    assert far < 0.75 * near


def test_textures_show_close_up():
    for material in Material:
        if material not in SMOOTH:
            assert looks(material, (0.2, 0.2, 0.2), 0.002).std() > 0.002


def test_road_paint_wears_off_to_dark_asphalt_in_places():
    paint = looks(Material.ASPHALT, (0.7, 0.7, 0.7), 0.01)[:, 1]
    assert np.median(paint) > 0.45
    assert 0.01 < np.mean(paint < 0.35) < 0.4


@given(
    position=st.floats(-50, 50),
    width=st.floats(0.0, 8.0),
    period=st.floats(0.1, 4.0),
    part=st.floats(0.01, 0.9),
)
def test_lines_cover_the_share_of_the_pixel_that_lies_on_them(position, width, period, part):
    assume(width > 1e-3)
    thickness = part * period
    expected = reference.covered_share(position, width, period, thickness)
    assert lines(position, width, period, thickness) == pytest.approx(expected, abs=5e-3)


@given(spot=spots, period=st.floats(0.1, 2.0))
def test_a_grid_covers_what_either_of_its_families_of_lines_covers(spot, period):
    across = lines(spot.u, spot.width_u, period, 0.02)
    along = lines(spot.v, spot.width_v, 2 * period, 0.02)
    covered = grid_lines(spot, period, 2 * period, 0.02)
    assert covered == pytest.approx(across + along - across * along, abs=1e-9)


@given(spot=spots)
def test_every_other_row_of_a_bond_is_moved_by_half_a_stone(spot):
    moved = in_bond(spot, 0.25, 0.08)
    row = int(np.floor(spot.v / 0.08))
    assert moved.u - spot.u == pytest.approx(0.125 * (row % 2), abs=1e-9)
    assert -0.5 <= off_center(moved.u, 0.25) <= 0.5


@given(
    x=st.floats(-1e4, 1e4), y=st.floats(-1e4, 1e4), seed=st.integers(0, 2**40), axis=st.booleans()
)
def test_noise_is_bounded_and_continuous(x, y, seed, axis):
    here = value_noise(x, y, seed)
    step = 1e-4
    there = value_noise(x + step * axis, y + step * (not axis), seed)
    assert -1.0 <= here <= 1.0
    # Between two hashed values the cubic is at most 1.5 times as steep as a line.
    assert abs(there - here) < 3.1 * step + 1e-9


def test_hashed_numbers_are_even_and_independent_of_their_neighbours():
    values = np.array([[hashed(x, y, 9) for x in range(-40, 40)] for y in range(-40, 40)])
    assert (values >= 0).all()
    assert (values < 1).all()
    counts, _ = np.histogram(values, bins=8, range=(0, 1))
    assert counts.min() > 0.85 * values.size / 8
    for other in (values[1:, :], values[:, 1:], values[1:, 1:]):
        part = values[: other.shape[0], : other.shape[1]]
        assert abs(np.corrcoef(part.ravel(), other.ravel())[0, 1]) < 0.05


@given(spot=spots, layer=st.integers(0, 20))
def test_every_kind_of_noise_stays_in_its_range(spot, layer):
    assert -1.0 <= speckle(spot, 0.03, layer) <= 1.0
    assert -1.0 <= clouded(spot, 0.3, 2.0, layer) <= 1.0
    assert -1.0 <= per_tile(spot, 0.2, 0.3, layer) <= 1.0
    assert 0.0 <= crack(spot, 0.16, 0.03, layer) <= 1.0


def test_speckle_of_many_grains_falls_with_the_root_of_their_number():
    rng = np.random.default_rng(1)
    places = rng.uniform(0, 500, size=(3000, 2))
    contrast = [
        np.std([speckle(Spot(float(u), float(v), width, width, 1), 0.02, 0) for u, v in places])
        for width in (0.04, 0.16, 0.64)
    ]
    assert contrast[0] / contrast[1] == pytest.approx(4.0, rel=0.1)
    assert contrast[1] / contrast[2] == pytest.approx(4.0, rel=0.1)

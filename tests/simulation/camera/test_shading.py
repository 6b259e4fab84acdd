"""Light on surfaces: shadows where geometry has them, mirrors, ambient light, haze, lamps."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sightline.geometry.kitti_mount import KITTI_LIDAR_HEIGHT_M
from sightline.simulation.camera.ambient import ambient_of, gathered_ambient
from sightline.simulation.camera.radiance import pixel_radiance
from sightline.simulation.camera.samples import camera_view, pixel_samples
from sightline.simulation.camera.shading import (
    SUN_QUARTERS,
    lit_world,
    perpendicular,
    sun_visibility,
)
from sightline.simulation.rays.raycast import Raycaster
from sightline.simulation.rays.surfaces import surfaces_at_hits
from sightline.simulation.scene import Material
from tests.reference import shading as reference
from tests.simulation.camera.scenes import (
    DAY,
    DUSK,
    EVEN,
    IMAGE_SIZE,
    block,
    ground,
    rectangle,
    scene_of,
    small_calibration,
)


class Observed:
    """Render a scene with the small camera."""

    def __init__(self, scene, size=IMAGE_SIZE):
        self.size = size
        self.world = lit_world(scene, Raycaster(scene.mesh))
        self.view = camera_view(small_calibration(), scene.ego, KITTI_LIDAR_HEIGHT_M)
        self.samples = pixel_samples(self.world, self.view, size, (0.0, 0.0))
        self.found = surfaces_at_hits(
            self.world.mesh, self.samples.rays, self.samples.hits, self.view.pixel_angle
        )
        self.faces = self.samples.hits.faces.reshape(size)

    def radiance(self):
        return pixel_radiance(
            self.world,
            self.samples,
            self.view.pixel_angle,
            ambient_stride=2,
            ambient_rays=8,
            brightest=100.0,
        )

    def ambient(self, stride=2, rays=4):
        grid = gathered_ambient(
            self.world, self.found, self.size, stride=stride, rays_per_point=rays
        )
        pixels = self.samples.columns, self.samples.rows
        ambient = ambient_of(self.world.light, grid, self.found, *pixels)
        return ambient.reshape(*self.size, 3)


def test_a_lone_block_shades_the_ground_where_geometry_says():
    low, high = (8.0, -1.0, 0.0), (10.0, 1.0, 1.4)
    seen = Observed(scene_of([ground()], [block(low, high)]))
    on_ground = (seen.faces == 0) | (seen.faces == 1)
    radiance = seen.radiance()[..., 1]
    places = seen.found.positions.reshape(*IMAGE_SIZE, 3)
    near = on_ground & (np.abs(places[..., 1]) < 5) & (places[..., 0] < 16)
    shaded = np.zeros(IMAGE_SIZE, bool)
    for row, column in zip(*np.nonzero(near), strict=True):
        start = places[row, column] + [0, 0, 1e-4]
        shaded[row, column] = reference.segment_meets_box(start, DAY.sun_direction, low, high)
    assert shaded.sum() > 50
    assert radiance[near & ~shaded].mean() > 2.5 * radiance[shaded].mean()
    threshold = 0.5 * (np.median(radiance[near & ~shaded]) + np.median(radiance[shaded]))
    wrong = ((radiance < threshold) != shaded)[near].mean()
    assert wrong < 0.04


@given(softness=st.floats(0.1, 0.25))
@settings(max_examples=8)
def test_a_larger_sun_has_a_wider_penumbra(softness):
    def partly_lit(angular_radius):
        light = replace(DAY, sun_softness=angular_radius)
        roof = rectangle((-20, -3, 8), (60, 0, 0), (0, 30, 0), Material.PLASTIC)
        seen = Observed(scene_of([ground(), roof], light=light))
        pixels = np.arange(len(seen.samples.strata), dtype=np.int32)
        visible = sun_visibility(seen.world, seen.found, pixels, seen.samples.strata)
        lit = visible.reshape(IMAGE_SIZE)
        tiles = lit[: 94 // 2 * 2, : 311 // 2 * 2].reshape(47, 2, 155, 2).mean(axis=(1, 3))
        return ((tiles > 0) & (tiles < 1)).sum()

    assert partly_lit(softness) > partly_lit(0.0)
    assert partly_lit(2 * softness) > partly_lit(softness)


def test_four_neighbours_look_at_four_quarters_of_the_sun():
    seen = Observed(scene_of([ground()]))
    strata = seen.samples.strata.reshape(IMAGE_SIZE)
    for row, column in ((0, 0), (17, 33), (92, 309)):
        tile = strata[row : row + 2, column : column + 2]
        assert set(tile.ravel().tolist()) == set(range(SUN_QUARTERS))


def test_a_penumbra_falls_evenly_from_light_to_dark():
    """No steps and no pattern: a level roof's edge, across the view, under a wide sun."""
    light = replace(DAY, sun_direction=(0.0, 0.6, 0.8), sun_softness=0.12)
    roof = rectangle((-60, 2, 10), (200, 0, 0), (0, 60, 0), Material.PLASTIC)
    seen = Observed(scene_of([ground(), roof], light=light))
    line = seen.radiance()[85, :, 1] / seen.found.albedos.reshape(*IMAGE_SIZE, 3)[85, :, 1]
    lit, dark = line.max(), line.min()
    partly = (line > dark + 0.1 * (lit - dark)) & (line < lit - 0.1 * (lit - dark))
    assert partly.sum() > 25
    steps = np.diff(line) / (lit - dark)
    assert np.abs(steps).max() < 0.15
    assert (np.sign(steps.sum()) * steps > -0.02).all()


def test_a_mirror_shows_the_coloured_wall_behind_it():
    """Ground of glass: where the mirrored ray meets the red wall the picture turns red."""
    wall = rectangle((30, 30, 0), (0, -60, 0), (0, 0, 3), Material.RETRO_REFLECTOR, (0.8, 0, 0))
    pond = ground(Material.WINDOW, (0.01, 0.01, 0.01), reach=200.0)
    seen = Observed(scene_of([pond, wall], light=EVEN))
    radiance = seen.radiance()
    on_pond = (seen.faces == 0) | (seen.faces == 1)
    # Without a hit, the position is not set.
    is_hit = (seen.faces >= 0)[..., None]
    places = np.where(is_hit, seen.found.positions.reshape(*IMAGE_SIZE, 3), 0.0)
    ways = seen.found.directions.reshape(*IMAGE_SIZE, 3).astype(float)
    # From a place on the ground the mirrored ray rises as steeply as the first one fell.
    height_at_wall = (30 - places[..., 0]) / ways[..., 0] * -ways[..., 2]
    across = places[..., 1] + (30 - places[..., 0]) / ways[..., 0] * ways[..., 1]
    mirrors_wall = on_pond & (height_at_wall < 2.5) & (np.abs(across) < 29)
    mirrors_sky = on_pond & (height_at_wall > 3.6)
    assert mirrors_wall.sum() > 500
    assert mirrors_sky.sum() > 500
    redness = radiance[..., 0] / radiance[..., 2]
    assert np.percentile(redness[mirrors_wall], 2) > 3.0
    assert np.percentile(redness[mirrors_sky], 98) < 1.1


def test_car_glass_shows_what_lies_behind_it_darker():
    wall = rectangle((30, 30, 0), (0, -60, 0), (0, 0, 12), Material.RETRO_REFLECTOR, (0, 0.8, 0))
    panes = [
        rectangle((x, 2, 0), (0, -4, 0), (0, 0, 5), Material.GLASS, (0.01, 0.01, 0.01))
        for x in (10, 11)
    ]
    clear = Observed(scene_of([wall], light=EVEN)).radiance()
    seen = Observed(scene_of([wall, *panes], light=EVEN))
    behind_glass = seen.faces >= 2
    glazed = seen.radiance()[behind_glass] / np.maximum(clear[behind_glass], 1e-6)
    assert behind_glass.sum() > 500
    assert 0.3 < np.median(glazed[:, 1]) < 0.8


def test_an_open_surface_under_an_even_sky_is_as_bright_as_its_albedo():
    seen = Observed(scene_of([ground(Material.CONCRETE, (0.6, 0.5, 0.4))], light=EVEN))
    on_ground = seen.faces >= 0
    albedos = seen.found.albedos.reshape(*IMAGE_SIZE, 3)[on_ground]
    np.testing.assert_allclose(seen.radiance()[on_ground], albedos, rtol=2e-3)


def test_a_white_room_under_an_even_sky_never_outshines_it():
    white = (1.0, 1.0, 1.0)
    walls = [
        rectangle((-20, 4, 0), (60, 0, 0), (0, 0, 8), Material.RETRO_REFLECTOR, white),
        rectangle((40, -4, 0), (-60, 0, 0), (0, 0, 8), Material.RETRO_REFLECTOR, white),
        rectangle((40, 4, 0), (0, -8, 0), (0, 0, 8), Material.RETRO_REFLECTOR, white),
    ]
    floor = ground(Material.RETRO_REFLECTOR, white)
    ambient = Observed(scene_of([floor, *walls], light=EVEN)).ambient()
    assert ambient.max() <= 1.0 + 1e-4
    assert ambient[80:].mean() < 0.9


def test_ambient_light_has_no_speckle_and_falls_towards_a_corner():
    """Noise of the prototype: here neighbouring pixels of a surface hardly differ."""
    wall = rectangle((12, 40, 0), (0, -80, 0), (0, 0, 9), Material.RETRO_REFLECTOR, (0.1, 0.1, 0.1))
    seen = Observed(scene_of([ground(color=(0.1, 0.1, 0.1)), wall], light=EVEN))
    ambient = seen.ambient()[..., 1]
    on_ground = seen.faces < 2
    inside = on_ground[:, 2:] & on_ground[:, :-2]
    sideways = np.abs(ambient[:, 1:-1] - 0.5 * (ambient[:, 2:] + ambient[:, :-2]))
    assert sideways[inside].max() < 0.02
    middle = ambient[on_ground[:, 155], 155]
    assert middle[0] < 0.85 * middle[-1]
    assert (np.diff(middle) > -0.01).all()


def test_a_coloured_wall_in_the_sun_tints_the_shade_before_it():
    light = replace(DAY, sun_direction=(-0.6, 0.0, 0.8), cloud_cover=0.0)
    for color, channel in (((0.8, 0.05, 0.05), 0), ((0.05, 0.05, 0.8), 2)):
        wall = rectangle((12, 40, 0), (0, -80, 0), (0, 0, 9), Material.RETRO_REFLECTOR, color)
        seen = Observed(scene_of([ground(), wall], light=light))
        foot = (seen.faces < 2) & (seen.found.positions[:, 0].reshape(IMAGE_SIZE) > 10)
        plain = Observed(scene_of([ground()], light=light)).ambient()[foot]
        tint = (seen.ambient()[foot] / plain).mean(axis=0)
        assert tint[channel] > 1.3 * tint[1]


def test_haze_turns_what_is_far_into_the_horizon():
    far = rectangle((90, 300, -9), (0, -600, 0), (0, 0, 200), Material.RUBBER, (0, 0, 0))
    radiance = {}
    for haze_m in (20.0, 1e6):
        light = replace(EVEN, haze_m=haze_m, sky_horizon=(0.7, 0.8, 0.9))
        radiance[haze_m] = Observed(scene_of([far], light=light)).radiance()[40, 150]
    np.testing.assert_allclose(radiance[1e6], 0.0, atol=0.02)
    assert (radiance[20.0] > 0.6).all()
    assert radiance[20.0][2] > radiance[20.0][0]


@pytest.mark.parametrize(
    ("material", "glows"),
    [(Material.HEADLIGHT, True), (Material.TAIL_LIGHT, True), (Material.PLASTIC, False)],
)
def test_lamps_are_lit_at_dusk_only(material, glows):
    lamp = rectangle((8, 2, 0), (0, -4, 0), (0, 0, 3), material, (0.8, 0.2, 0.2))
    exposed = {}
    for name, light in (("dusk", DUSK), ("day", replace(DUSK, sky_horizon=(0.9, 0.9, 0.9)))):
        seen = Observed(scene_of([lamp], light=light))
        red = seen.radiance()[seen.faces >= 0][:, 0].mean()
        exposed[name] = red / np.mean(light.sky_horizon)
    assert (exposed["dusk"] > 2 * exposed["day"]) == glows


def test_some_windows_are_lit_at_dusk_each_as_a_whole():
    panes = [
        rectangle((12, y, z), (0, -0.9, 0), (0, 0, 0.9), Material.WINDOW, (0.02, 0.02, 0.02))
        for y in range(-4, 6)
        for z in range(4)
    ]
    seen = Observed(scene_of(panes, light=DUSK))
    red = seen.radiance()[..., 0]
    means = [
        [red[seen.faces == 2 * pane + half].mean() for half in (0, 1)]
        for pane in range(len(panes))
        if all((seen.faces == 2 * pane + half).sum() > 3 for half in (0, 1))
    ]
    lit = np.array(means) > 0.04
    np.testing.assert_array_equal(lit[:, 0], lit[:, 1])
    assert 0.05 < lit[:, 0].mean() < 0.8


@given(
    axis=st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-1, 1)).filter(
        lambda axis: np.linalg.norm(axis) > 1e-3
    )
)
def test_perpendicular_vectors_make_a_frame(axis):
    unit = np.array(axis) / np.linalg.norm(axis)
    side, rise = perpendicular(tuple(float(value) for value in unit))
    frame = np.stack((side, rise, unit))
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(frame) == pytest.approx(1.0)

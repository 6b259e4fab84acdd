"""The kinds of the camera alone, against loops."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.corruptions.camera_precipitation import (
    CameraRain,
    Exposure,
    draw_particles,
    draw_streaks,
    from_light,
    to_light,
)
from sightline.corruptions.exposure import add_value, reduce_contrast
from sightline.corruptions.haze import CameraFog, airlight_level, extinction_per_m, to_levels, veil
from sightline.corruptions.kinds import KINDS
from sightline.corruptions.noise import add_uniform_noise, detect_photons
from sightline.corruptions.optics import blur, cover, disc_kernel, line_kernel
from sightline.corruptions.pixel_box import AreaDrawing
from sightline.corruptions.precipitation import rain, snow
from sightline.corruptions.scene_depth import scene_horizon, scene_ranges
from sightline.corruptions.sun_glare import shine
from sightline.geometry.calibration import Calibration
from tests.data.scenes import SIZE, few, rotation, sample_of, seeds
from tests.geometry.cameras import kitti_like_calibration
from tests.reference import corruptions as reference

sizes = st.sampled_from([(1, 1), (1, 6), (7, 5)])


def image_of(seed, size=(6, 9)):
    drawn = np.random.default_rng(seed).integers(0, 256, (3, *size), dtype=np.uint8)
    drawn[:, 0, 0] = 0
    return torch.from_numpy(drawn)


@few
@given(seed=seeds, width=st.floats(0, 255))
def test_even_noise_is_added_as_loops_say(seed, width):
    image = image_of(seed)
    found = add_uniform_noise(image, width, np.random.default_rng(seed))
    drawn = np.random.default_rng(seed).random(image.shape, dtype=np.float32)
    assert found.tolist() == reference.noisy_evenly(image.tolist(), width, drawn)


@few
@given(seed=seeds, photons=st.floats(0.2, 80))
def test_photons_are_counted_as_their_chances_say(seed, photons):
    image = image_of(seed, (2, 3))
    means = photons * np.arange(256) / 255
    found = detect_photons(image, means, 255 / photons, np.random.default_rng(seed))
    draws = np.random.default_rng(seed).integers(0, 65536, image.shape, dtype=np.uint16)
    for level, draw, new in zip(image.flatten(), draws.flatten(), found.flatten(), strict=True):
        count = reference.photons(means[int(level)], int(draw))
        assert abs(int(new) - min(255, count * 255 / photons)) <= 0.5 + 1e-9


def test_photons_have_the_mean_and_the_spread_of_poisson():
    grey = torch.full((1, 300, 300), 128, dtype=torch.uint8)
    found = detect_photons(grey, np.full(256, 20.0), 5.0, np.random.default_rng(0)).double() / 5
    assert found.mean().item() == pytest.approx(20, rel=0.005)
    assert found.var().item() == pytest.approx(20, rel=0.03)


@few
@given(seed=seeds, size=sizes, radius=st.floats(0, 4), angle=st.floats(0, 180))
def test_blurring_is_the_mean_of_the_surroundings(seed, size, radius, angle):
    image = image_of(seed, size)
    for kernel in (disc_kernel(radius), line_kernel(1 + 2 * radius, angle)):
        found = blur(image[:1], kernel)
        expected = reference.blurred(image[0].tolist(), kernel.tolist())
        np.testing.assert_allclose(found[0], expected, atol=0.51)


@given(length=st.floats(1, 31), angle=st.floats(0, 180), radius=st.floats(0, 10))
def test_kernels_are_even_of_sum_1_and_as_long_as_they_are_said_to_be(length, angle, radius):
    line, disc = line_kernel(length, angle).astype(float), disc_kernel(radius).astype(float)
    for kernel in (line, disc):
        assert kernel.sum() == pytest.approx(1, abs=1e-5)
        assert kernel.min() >= 0
        np.testing.assert_allclose(kernel, kernel[::-1, ::-1], atol=1e-5)
    half = line.shape[0] // 2
    y, x = np.mgrid[half : -half - 1 : -1, -half : half + 1]
    along = x * math.cos(math.radians(angle)) + y * math.sin(math.radians(angle))
    # An even line of this length has this variance; sharing among pixels adds a quarter at most.
    assert 0 <= (line * along**2).sum() - (length - 1) ** 2 / 12 <= 0.3
    area = math.pi * radius**2
    if radius >= 1:
        assert 1 / disc.max() == pytest.approx(area, rel=0.06)


@few
@given(seed=seeds, extinction=st.floats(0, 0.2), airlight=st.floats(0, 255))
def test_haze_follows_koschmieder_pixel_by_pixel(seed, extinction, airlight):
    image = image_of(seed)
    ranges = np.random.default_rng(seed).uniform(1, 300, (6, 9)).astype(np.float32)
    found = veil(image, ranges, extinction, airlight)
    for index in np.ndindex(3, 6, 9):
        level = reference.veiled(int(image[index]), ranges[index[1:]], extinction, airlight)
        assert found[index] == pytest.approx(level, abs=0.01)
    assert to_levels(found.copy()).tolist() == np.rint(found).clip(0, 255).tolist()


def test_as_far_as_one_can_see_a_twentieth_of_the_contrast_is_left():
    black_and_white = torch.tensor([0, 255], dtype=torch.uint8).expand(3, 1, 2)
    ranges = np.full((1, 2), 60, dtype=np.float32)
    found = veil(black_and_white, ranges, extinction_per_m(60.0), 200.0)
    np.testing.assert_allclose(found[:, 0, 1] - found[:, 0, 0], 0.05 * 255, rtol=1e-4)


def test_fog_thickens_with_distance_and_is_dark_at_night():
    sample = sample_of(depth=torch.linspace(5, 150, SIZE[1]).expand(SIZE).contiguous())
    found = CameraFog(visibility_m=60.0).corrupt(sample, np.random.default_rng(0))
    assert found.record.parameters["distances_from"] == "depth"
    spread = found.sample.image.double().std(dim=(0, 1))
    assert spread[:40].mean() > 4 * spread[-40:].mean()
    assert airlight_level(torch.zeros(3, 5, 5, dtype=torch.uint8)) == 0


def test_distances_are_those_of_a_wall_before_the_sensors():
    y, z = (
        v.flatten()
        for v in torch.meshgrid(
            torch.linspace(-12, 12, 200), torch.linspace(-1.5, 3, 40), indexing="ij"
        )
    )
    points = torch.stack((torch.full_like(y, 20.27), y, z, torch.zeros_like(y)), dim=1)
    calibration = kitti_like_calibration()
    sample = sample_of(
        points=points, depth=None, image=None, calibration=calibration, image_size=(375, 1242)
    )
    found = scene_ranges(sample)
    assert found.source == "sweep"
    rows, columns = np.mgrid[100:220, 300:900]
    rays = np.sqrt(1 + ((columns - 609.6) ** 2 + (rows - 172.9) ** 2) / 721.5**2)
    np.testing.assert_allclose(found.ranges_m[100:220, 300:900], 20 * rays, rtol=0.03)


def test_distances_do_not_end_where_the_nearest_measurement_changes():
    depth = torch.zeros(SIZE)
    depth[110:], depth[40:, 190:210] = 80, 10  # a wood, and a trunk before it
    image = torch.full((3, *SIZE), 100, dtype=torch.uint8)
    image[0], image[:, :, 190:210] = 60, 20
    found = scene_ranges(sample_of(depth=depth, points=None, image=image))
    passing = np.exp(-found.ranges_m[50:100, 215:] / 20)
    assert np.abs(np.diff(passing, axis=1)).max() < 0.028
    np.testing.assert_allclose(found.ranges_m[50:100, 200], 10, rtol=0.02)


def pitched(pitch_deg):
    """A camera whose view is lowered against a level LiDAR."""
    calibration = kitti_like_calibration().crop(420, 120)
    lowered = torch.eye(4, dtype=torch.float64)
    lowered[:3, :3] = rotation("x", math.radians(pitch_deg))
    return Calibration(
        image_from_camera=calibration.image_from_camera,
        camera_from_lidar=lowered @ calibration.camera_from_lidar,
    )


@pytest.mark.parametrize(
    ("pitch_deg", "row_px"), [(0, 52.854), (0.9, 52.854), (1.5, 33.96), (-2, 78.05), (5, -10.27)]
)
def test_the_horizon_is_that_of_the_mount_unless_its_pitch_is_too_small_to_know(pitch_deg, row_px):
    sample = sample_of(calibration=pitched(pitch_deg), points=None, depth=None)
    assert scene_horizon(sample) == pytest.approx(row_px, abs=0.02)
    ranges = scene_ranges(sample).ranges_m
    horizon = min(max(round(row_px), -1), SIZE[0])
    assert (ranges[: horizon + 1] >= 1e5).all()
    assert (ranges[horizon + 12 :] < 130).all()
    glare = KINDS["sun_glare"].at(1)
    for seed in range(20):
        record = glare.corrupt(sample, np.random.default_rng(seed)).record
        assert record.parameters["centre_px"][1] <= max(row_px, 0)


def test_without_any_distance_the_road_is_flat_and_the_sky_is_far():
    sample = sample_of(points=None, depth=None)
    ranges = scene_ranges(sample).ranges_m
    horizon = round(float(sample.calibration.image_from_camera[1, 2]))
    assert (ranges[: horizon - 1] > 1e5).all()
    assert (np.diff(ranges[horizon + 1 :, 200]) < 0).all()


@few
@given(seed=seeds, added=st.floats(0, 255), factor=st.floats(0, 1))
def test_brightness_and_contrast_are_as_loops_say(seed, added, factor):
    image = image_of(seed)
    brighter, flat = add_value(image, added), reduce_contrast(image, factor)
    for row, column in np.ndindex(6, 9):
        expected = reference.with_value(image[:, row, column].tolist(), added)
        np.testing.assert_allclose(brighter[:, row, column], expected, atol=0.501)
    means = image.double().mean(dim=(1, 2), keepdim=True)
    np.testing.assert_allclose(flat, means + factor * (image - means), atol=0.501)


@few
@given(ends=st.tuples(*[st.floats(-4, 12)] * 4), width=st.floats(1, 5), opacity=st.floats(0, 1))
def test_a_streak_covers_what_is_near_its_line(ends, width, opacity):
    levels = np.arange(63, dtype=np.float32).reshape(1, 7, 9)
    expected = reference.streaked(levels[0].tolist(), ends, width, opacity, 200.0)
    draw_streaks(levels, np.array([ends]), np.array([width]), np.array([opacity]), 200.0)
    np.testing.assert_allclose(levels[0], expected, atol=1.5)


def test_drops_fall_with_the_wind_and_there_are_as_many_as_the_rate_says():
    def drops(rate, wind):
        return draw_particles(
            rain(rate),
            kitti_like_calibration(),
            (375, 1242),
            Exposure(speed_mps=0.0),
            wind,
            np.random.default_rng(0),
            drawn_m=4.0,
        )

    streaks = drops(20.0, 3.0)
    x0, y0, x1, y1 = streaks.ends_px.T
    assert (y1 > y0).all()
    assert (x1 > x0).all()
    assert streaks.opacities.max() <= 1
    assert streaks.widths_px.min() >= 1
    assert len(drops(50.0, 0.0).opacities) > 1.5 * len(streaks.opacities)


class Counting(np.random.Generator):
    """Draws no particle, but notes how many there would be."""

    def __init__(self):
        super().__init__(np.random.PCG64(0))
        self.expected = []

    def poisson(self, mean):
        self.expected.append(mean)
        return 0


@pytest.mark.parametrize("size", [(1, 1), (2, 3), (40, 124)])
def test_small_images_hold_no_more_particles_than_memory_does(size):
    counting = Counting()
    draw_particles(
        rain(50.0),
        kitti_like_calibration().resize(size[1] / 1242, size[1] / 1242),
        size,
        Exposure(),
        0.0,
        counting,
        drawn_m=5.0,
    )
    (expected,) = counting.expected
    assert 1 <= expected < 1e7


@pytest.mark.parametrize("rate", [5.0, 20.0, 50.0])
def test_the_extinction_of_rain_is_the_sum_over_its_drops_and_what_was_measured(rate):
    shower = rain(rate)
    sizes_mm = (np.arange(100000) + 0.5) * 2e-4
    counts = 8000 * np.exp(-4.1 * rate**-0.21 * sizes_mm) * 2e-4  # Marshall and Palmer 1948
    areas_m2 = math.pi / 4 * (sizes_mm * 1e-3) ** 2
    assert shower.extinction_per_m == pytest.approx(2 * (counts * areas_m2).sum(), rel=1e-3)
    measured = 0.21e-3 * rate**0.74  # Ulbrich and Atlas 1985
    assert 1.12 < shower.extinction_per_m / measured < 1.46
    assert shower.per_cubic_metre == pytest.approx(counts[sizes_mm > 0.5].sum(), rel=1e-3)


def test_drawn_particles_have_the_mean_size_of_their_distribution():
    for particles, swelling in ((rain(20.0), 1.0), (snow(1.5), 10 ** (1 / 3))):
        drawn = particles.draw_diameters_m(200000, np.random.default_rng(0))
        expected = swelling * 1e-3 * (0.5 + 1 / particles.slope_per_mm)
        assert drawn.mean() == pytest.approx(expected, rel=0.01)
        assert drawn.min() >= swelling * 0.5e-3
    speeds = rain(5.0).speeds_mps(np.array([1e-3, 5e-3]))
    np.testing.assert_allclose(speeds, [4.0, 9.1], atol=0.1)


@pytest.mark.parametrize("kind", ["camera_rain", "camera_snow"])
def test_more_of_what_falls_is_seen_before_what_is_dark(kind):
    image = torch.full((3, *SIZE), 40, dtype=torch.uint8)
    image[:, : SIZE[0] // 4] = 230
    sample, dark = sample_of(image=image), slice(SIZE[0] // 4, None)
    shares = []
    for severity in range(1, 6):
        worse = KINDS[kind].at(severity)(sample, np.random.default_rng(0)).image.int()
        shares.append(float((worse[:, dark] > 55).any(dim=0).float().mean()))
    assert shares == sorted(shares)
    assert shares[0] > 0.02
    assert shares[-1] > 0.5


@given(level=st.floats(0, 255))
def test_levels_come_back_from_the_light_that_they_stand_for(level):
    levels = np.full(1, level, np.float32)
    light = to_light(levels)
    assert 0 <= light[0] <= 1
    np.testing.assert_allclose(from_light(light), levels, atol=1e-3)
    assert to_light(np.full(1, 128, np.float32))[0] == pytest.approx(0.2159, abs=1e-3)


def test_rain_dims_what_is_far_away():
    sample = sample_of(depth=torch.linspace(5, 1500, SIZE[1]).expand(SIZE).contiguous())
    found = CameraRain(rate_mm_per_h=50.0).corrupt(sample, np.random.default_rng(0)).sample.image
    spread = found.double().std(dim=(0, 1))
    assert spread[:40].mean() > 2 * spread[-40:].mean()


@few
@given(seed=seeds, x=st.floats(-3, 12), y=st.floats(-3, 9), radius=st.floats(0.1, 20))
def test_the_sun_is_white_and_its_halo_falls_with_the_square_of_the_distance(seed, x, y, radius):
    image = image_of(seed)
    found = shine(image, (x, y), radius)
    for row, column in np.ndindex(6, 9):
        square = (column - x) ** 2 + (row - y) ** 2
        if abs(math.sqrt(square) - radius) < 1e-3:  # a pixel on the rim is on either side of it
            continue
        for channel, top in enumerate((255, 245, 220)):
            lit = int(image[channel, row, column]) + top * radius**2 / max(square, 1e-9)
            expected = 255 if square <= radius**2 else min(lit, 255)
            assert abs(int(found[channel, row, column]) - expected) <= 0.6


@few
@given(x=st.floats(-1, 12), y=st.floats(-1, 9), radius=st.floats(1, 20), opacity=st.floats(0, 1))
def test_dirt_is_densest_in_its_middle_and_ends_at_its_rim(x, y, radius, opacity):
    passing = np.full((8, 11), 0.8, dtype=np.float32)
    cover(passing, (x, y), radius, opacity)
    for row, column in np.ndindex(8, 11):
        share = ((column - x) ** 2 + (row - y) ** 2) / radius**2
        expected = 0.8 * (1 - opacity * max(1 - share**2, 0) ** 2)
        assert passing[row, column] == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize("share", [0.05, 0.1, 0.2, 0.3, 0.4])
@pytest.mark.parametrize("placement", ["object", "uniform"])
def test_a_box_has_the_area_asked_for_and_lies_in_the_image(share, placement):
    rng = np.random.default_rng(0)
    for seed in range(20):
        box = AreaDrawing(area_share=share, placement=placement).draw(sample_of(seed), rng)
        height, width = SIZE
        assert 0 <= box.left < box.right <= width
        assert 0 <= box.top < box.bottom <= height
        area = (box.right - box.left) * (box.bottom - box.top)
        assert area == pytest.approx(share * height * width, rel=0.03)


def test_impulses_are_black_or_white_alike_and_as_many_as_asked_for():
    grey = torch.full((3, *SIZE), 100, dtype=torch.uint8)
    sample = sample_of(image=grey)
    found = KINDS["camera_impulse_noise"].at(4).corrupt(sample, np.random.default_rng(0))
    shares = [(found.sample.image == level).double().mean().item() for level in (0, 100, 255)]
    np.testing.assert_allclose(shares, (0.085, 0.83, 0.085), atol=0.003)
    assert torch.equal(found.camera_mask, (found.sample.image != 100).any(dim=0))

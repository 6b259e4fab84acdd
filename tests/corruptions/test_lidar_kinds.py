"""The kinds of the LiDAR and of its alignment, against loops."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sightline.corruptions.kinds import KINDS
from sightline.corruptions.lidar_fog import LidarFog, fog_response
from sightline.corruptions.lidar_loss import LidarCutout, LidarFov, LidarSector, spread_beams
from sightline.corruptions.lidar_precipitation import strongest_particles
from sightline.corruptions.misalignment import SpatialMisalignment, ego_motion
from sightline.corruptions.precipitation import snow
from sightline.corruptions.sensor import HDL_32E, HDL_64E, VLP_16, SpinningLidar, evenly_spaced
from sightline.corruptions.sun_glare import SunGlare
from tests.data.scenes import few, sample_of, seeds
from tests.reference import corruptions as reference
from tests.reference.geometry import project


def corrupt(corruption, sample, seed=0):
    return corruption.corrupt(sample, np.random.default_rng(seed))


@given(count=st.integers(1, 130), kept=st.integers(1, 130))
def test_beams_stay_in_an_order_whose_beginnings_are_spread(count, kept):
    order = spread_beams(count).tolist()
    assert order == reference.spread_order(count)
    first = sorted(order[: min(kept, count)])
    widest = max(b - a for a, b in zip(first, [*first[1:], first[0] + count], strict=True))
    assert widest <= 4 * count / len(first)


@pytest.mark.parametrize("lidar", [HDL_64E, HDL_32E, VLP_16, evenly_spaced(1, 0.0, 0.0)])
def test_a_ring_is_the_beam_of_the_nearest_elevation(lidar):
    points = sample_of(num_points=100).points
    expected = [reference.nearest_beam(p, lidar.beam_elevations_deg) for p in points.tolist()]
    assert lidar.ring_of(points).tolist() == expected


@few
@given(seed=seeds, angle=st.floats(1, 90))
def test_what_is_aside_or_in_the_wedge_is_lost(seed, angle):
    sample = sample_of(seed, num_points=100)
    sound = sample.points.tolist()
    found = corrupt(LidarFov(half_angle_deg=angle), sample)
    assert found.sample.points.tolist() == [
        p for p in sound if reference.turned_by(p, 0.0) <= angle
    ]
    found = corrupt(LidarSector(width_deg=angle), sample, seed)
    centre = found.record.parameters["centre_deg"]
    assert found.sample.points.tolist() == [
        p for p in sound if reference.turned_by(p, centre) > angle / 2
    ]
    left, right = (math.degrees(math.atan2(c, 721.5)) for c in (189.6, -210.4))
    assert right - 1 <= centre <= left + 1


@few
@given(seed=seeds, blobs=st.integers(0, 60))
def test_blobs_are_the_nearest_points_of_those_left(seed, blobs):
    sample = sample_of(seed, num_points=90)
    found = corrupt(LidarCutout(num_blobs=blobs), sample, seed)
    left = dict(enumerate(sample.points[:, :3].tolist()))
    rng = np.random.default_rng(seed)
    for _ in range(blobs):
        if len(left) <= 2:
            left = {}
            break
        centre = left[sorted(left)[rng.integers(len(left))]]
        for row in sorted(left, key=lambda r: math.dist(left[r], centre))[:2]:
            del left[row]
    assert found.point_sources.tolist() == sorted(left)


@pytest.mark.parametrize("kind", ["lidar_impulse_noise", "lidar_crosstalk", "lidar_point_drop"])
def test_exactly_so_many_points_are_struck(kind):
    sample = sample_of(num_points=1000)
    counts = {
        "lidar_impulse_noise": (33, 40, 50, 66, 100),
        "lidar_crosstalk": (4, 8, 12, 16, 20),
        "lidar_point_drop": (200, 400, 600, 800, 900),
    }[kind]
    struck = set()
    for severity, count in enumerate(counts, 1):
        broken = corrupt(KINDS[kind].at(severity), sample).broken_points
        assert broken.sum() == count
        rows = set(broken.nonzero()[:, 0].tolist())
        assert struck <= rows  # a worse severity strikes the same and more
        struck = rows


def test_noise_has_the_size_asked_for():
    sample = sample_of(num_points=20000)
    for kind, spread in (("gaussian", 0.06), ("uniform", 0.06 / math.sqrt(3))):
        found = corrupt(KINDS[f"lidar_{kind}_noise"].at(3), sample).sample.points
        moved = (found - sample.points)[:, :3].double()
        assert moved.std().item() == pytest.approx(spread, rel=0.02)
        assert moved.mean().abs().item() < 0.002
        assert torch.equal(found[:, 3], sample.points[:, 3])


@pytest.mark.parametrize("attenuation", [0.005, 0.06])
def test_the_response_of_fog_is_the_integral_over_the_pulse(attenuation):
    table = fog_response(attenuation, HDL_64E)
    best = (0.0, 0.0)
    for step in range(120):
        at = step * 0.1
        strength = reference.fog_response_at(at, attenuation, 0.9)
        best = max(best, (strength, at))
        assert table.strongest[step] == pytest.approx(best[0], rel=0.02, abs=1e-11)
    assert table.ranges_m[119] == pytest.approx(best[1], abs=0.11)


@few
@given(seed=seeds, attenuation=st.sampled_from([0.005, 0.02, 0.06, 0.2]))
def test_points_fade_are_lost_or_become_fog_as_loops_say(seed, attenuation):
    sample = sample_of(seed, num_points=60)
    found = corrupt(LidarFog(attenuation_per_m=attenuation), sample, seed)
    rng = np.random.default_rng(seed)
    behind = 20 * rng.beta(2, 20, size=60)
    margins = np.exp(rng.standard_exponential(60))
    table = fog_response(attenuation, HDL_64E)
    expected = []
    for row, point in enumerate(sample.points.tolist()):
        place = int(math.sqrt(sum(v**2 for v in point[:3])) / 0.1)
        response = (table.ranges_m[place], table.strongest[place])
        new = reference.foggy_point(point, behind[row], margins[row], attenuation, response)
        expected += [(row, *new)] if new else []
    assert found.point_sources.tolist() == [row for row, *_ in expected]
    new = np.array([point for _, *point in expected]).reshape(-1, 4)
    np.testing.assert_allclose(found.sample.points, new, rtol=1e-4, atol=1e-5)


def test_fog_before_what_is_absurdly_far_away_is_as_at_the_largest_range():
    points = torch.tensor([[1e25, 0, 0, 0.5]])
    found = corrupt(KINDS["lidar_fog"].at(3), sample_of(points=points))
    assert found.sample.points.isfinite().all()


@few
@given(seed=seeds)
def test_the_strongest_particle_before_the_target_is_seen(seed):
    particles, ranges = snow(2.5), np.random.default_rng(seed).uniform(0.5, 60, 40)
    found = strongest_particles(particles, HDL_64E, ranges, np.random.default_rng(seed))
    rng = np.random.default_rng(seed)
    size = 10 ** (1 / 3) * 6 / 3  # largest flake by the beam's width at 1 m, both in mm
    ice = (0.3031 / 2.3031) ** 2  # its reflectance: Fresnel
    reach = (ice * 120**2 / 0.9 * size**2) ** 0.25
    volume = math.pi / 3 * 0.0015**2 * reach**3
    counts = rng.poisson(particles.per_cubic_metre * volume, 40)
    places = reach * rng.random(counts.sum()) ** (1 / 3)
    diameters = particles.draw_diameters_m(int(counts.sum()), rng)
    start = 0
    for beam, count in enumerate(counts):
        of_beam = list(zip(places, diameters, strict=True))[start : start + count]
        start += count
        best = reference.strongest_before(
            ranges[beam], of_beam, ice, particles.extinction_per_m, 0.003, 0.9
        )
        assert found.ranges_m[beam] == pytest.approx(best[1] if best else 0)
        assert found.reflectances[beam] == pytest.approx(best[2] if best else 0)


@pytest.mark.parametrize("kind", ["lidar_rain", "lidar_snow"])
def test_in_rain_and_snow_points_stay_on_their_rays_and_come_nearer_or_stay(kind):
    sample = sample_of(num_points=3000)
    found = corrupt(KINDS[kind].at(5), sample)
    sound = sample.points[found.point_sources, :3].double()
    new = found.sample.points[:, :3].double()
    away = torch.linalg.cross(sound, new).norm(dim=1) / sound.norm(dim=1)
    assert away.max() < 1e-4
    further = new.norm(dim=1) - sound.norm(dim=1)
    assert further.max() < 0.4  # of targets: 0.09 m by the root of twice the signal by the noise
    false = int((further < -0.5).sum())
    parameters = found.record.parameters
    assert 0.8 * parameters["num_particle_echoes"] <= false <= parameters["num_particle_echoes"]
    assert parameters["num_lost"] == 3000 - len(new)


@few
@given(seed=seeds, angle=st.floats(0.1, 90), distance=st.floats(0, 2))
def test_a_misaligned_sweep_is_turned_by_the_angle_and_moved_by_the_distance(seed, angle, distance):
    points = torch.tensor([[0.0, 0, 0, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0.0]])
    corruption = SpatialMisalignment(rotation_deg=angle, translation_m=distance)
    found = corrupt(corruption, sample_of(points=points), seed).sample.points.double()
    assert found[0, :3].norm().item() == pytest.approx(distance, abs=1e-5)
    turn = found[1:, :3] - found[0, :3]
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-5)
    assert torch.det(turn).item() == pytest.approx(1, abs=1e-5)
    cosine = (turn.trace().item() - 1) / 2
    assert math.degrees(math.acos(min(cosine, 1))) == pytest.approx(angle, abs=0.1)


@few
@given(speed=st.floats(0, 40), rate=st.floats(-90, 90), time=st.floats(0, 1))
def test_the_car_drives_on_an_arc(speed, rate, time):
    found = ego_motion(speed, rate, time).numpy()
    x, y, yaw = reference.driven(speed, math.radians(rate), time, steps=500)
    np.testing.assert_allclose(found[:2, 3], (x, y), atol=1e-3)
    assert math.atan2(found[1, 0], found[0, 0]) == pytest.approx(yaw, abs=1e-6)


def test_of_an_older_sweep_all_that_stands_is_further_away():
    sample = sample_of(points=torch.tensor([[20.0, 0, 0, 0.5]]))
    found = corrupt(KINDS["misalignment_temporal"].at(5), sample)
    assert found.sample.points[0, 0] > 24.5
    assert found.record.parameters["speed_mps"] == 10


@pytest.mark.parametrize("yaw_deg", [0, 55, 180])
@pytest.mark.parametrize("height_m", [None, 1.0, 3.0])
def test_of_an_older_sweep_the_returns_of_the_own_car_stay(yaw_deg, height_m):
    low = 0.1 - (1.73 if height_m is None else height_m)  # on the road beside the car
    level = torch.tensor(
        [
            [-0.7, 0.4, -0.4, 0.5],  # roof
            [2.2, 0.3, -0.6, 0.5],  # bonnet
            [0.1, 1.6, -0.6, 0.5],  # bonnet or boot, seen by a side camera
            [2.2, 0.3, low, 0.5],
            [0.5, 1.5, -0.4, 0.5],  # beside the car
            [3.0, 0.3, -0.4, 0.5],
        ]
    )
    mount = torch.eye(4, dtype=torch.float64)
    turn = Rotation.from_euler("zy", (yaw_deg, 15), degrees=True).as_matrix()
    mount[:3, :3] = torch.from_numpy(turn)
    points = torch.cat((level[:, :3] @ mount[:3, :3].float(), level[:, 3:]), dim=1)
    sample = sample_of(points=points, level_from_lidar=mount, lidar_height_m=height_m)
    found = corrupt(KINDS["misalignment_temporal"].at(5), sample)
    moved_m = (found.sample.points - points)[:, :3].norm(dim=1)
    assert (moved_m[:3] == 0).all()
    assert (moved_m[3:] > 4.5).all()
    assert found.broken_points.tolist() == [False, False, False, True, True, True]


@few
@given(seed=seeds, yaw=st.floats(-180, 180), pitch=st.floats(-20, 20))
def test_the_car_drives_ahead_however_the_lidar_is_mounted(seed, yaw, pitch):
    level = sample_of(seed, num_points=50)
    mount = torch.eye(4, dtype=torch.float64)
    turn = Rotation.from_euler("zy", (yaw, pitch), degrees=True)
    mount[:3, :3] = torch.from_numpy(turn.as_matrix())
    turned = torch.cat((level.points[:, :3] @ mount[:3, :3].float(), level.points[:, 3:]), dim=1)
    mounted = replace(level, points=turned, level_from_lidar=mount)
    older, older_mounted = (
        corrupt(KINDS["misalignment_temporal"].at(5), each, seed).sample.points
        for each in (level, mounted)
    )
    found = older_mounted[:, :3] @ mount[:3, :3].float().T
    np.testing.assert_allclose(found, older[:, :3], atol=1e-4)


@few
@given(seed=seeds)
def test_in_the_sun_points_are_lost_and_ghosts_are_in_its_direction(seed):
    sample = sample_of(seed, num_points=500)
    found = corrupt(SunGlare(radius_px=70.0, ghost_share=0.02), sample, seed)
    (x, y), matrices = found.record.parameters["centre_px"], sample.calibration
    camera = (matrices.image_from_camera.tolist(), matrices.camera_from_lidar.tolist())
    kept = []
    for row, point in enumerate(sample.points.double().tolist()):
        pixel = project(point[:3], *camera)
        if pixel is None or math.hypot(pixel[0] - x, pixel[1] - y) > 70:
            kept.append(row)
    assert found.point_sources.tolist() == kept + [-1] * 10
    for ghost in found.sample.points[-10:].double():
        elevation = math.degrees(math.atan2(ghost[2], math.hypot(ghost[0], ghost[1])))
        assert HDL_64E.beam_elevations_deg[-1] - 1e-3 <= elevation <= 2 + 1e-3
        assert 1.5 <= ghost[:3].norm() <= 80
        far = project((1e4 * ghost[:3]).tolist(), *camera)
        assert abs(far[0] - x) <= 71


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"beam_elevations_deg": ()}, "must be angles"),
        ({"beam_elevations_deg": (0.0, 1.0)}, "must fall from the top"),
        ({"beam_elevations_deg": (0.0,), "max_range_m": 0.5}, "the ranges must be finite"),
        ({"beam_elevations_deg": (0.0,), "beam_divergence_mrad": 0.0}, "above 0, got 0"),
    ],
)
def test_sensors_that_cannot_be_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        SpinningLidar(**settings)

import functools
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from sightline.corruptions.kinds import find_kind
from sightline.health.lidar_checks import check_lidar
from sightline.health.limits import read_limits
from sightline.health.monitor import HealthMonitor
from sightline.health.ring_order import number_rings
from sightline.health.shipped import (
    MIN_FIRST_FRAMES,
    DriveChecks,
    check_frames,
    choose_shipped,
    fit_to_first,
    shipped_limits,
)
from sightline.health.sphere import to_sphere
from sightline.simulation.settings import SimulationConfig
from sightline.simulation.simulator import simulate_frame
from tests.health.frames import sound, with_image, with_points


def as_jpeg(sample, quality):
    def change(image):
        stored = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        return cv2.imdecode(stored, cv2.IMREAD_COLOR)

    return with_image(sample, change)


def thinned(sample, every):
    return with_points(
        sample, lambda points: points[number_rings(to_sphere(points)[1]) % every == 0]
    )


@functools.cache
def checks(quality=None, every=1):
    frames = [thinned(sound(n), every) for n in (0, 1)]
    return check_frames(frames if quality is None else [as_jpeg(each, quality) for each in frames])


def test_what_the_usual_limits_fit_is_judged_by_them():
    chosen = choose_shipped(checks(), are_jpeg_files=True)
    assert chosen.limits == read_limits()
    assert chosen.warnings == ()


@pytest.mark.parametrize("quality", [75, 85, 92])
def test_pictures_with_the_blocks_of_jpeg_are_judged_by_its_limits(quality):
    chosen = choose_shipped(checks(quality))
    assert chosen.limits == shipped_limits("jpeg", 64)
    monitor = HealthMonitor(chosen.limits)
    for index in (0, 1):
        assert not monitor(as_jpeg(sound(index), quality)).camera.is_alarm


@pytest.mark.parametrize(("every", "beams"), [(2, 32), (4, 16)])
def test_sweeps_of_fewer_rings_are_judged_by_limits_for_fewer_beams(every, beams):
    chosen = choose_shipped(checks(every=every))
    assert chosen.limits == shipped_limits("png", beams)
    assert f"judged as of {beams} beams" in chosen.warnings[0]
    monitor = HealthMonitor(chosen.limits)
    for index in (0, 1):
        health = monitor(thinned(sound(index), every))
        assert not health.lidar.is_alarm
        assert abs(health.yaw_deg) < 0.3


@pytest.mark.parametrize(("lidar", "beams"), [("hdl-32e", 32), ("vlp-16", 16)])
def test_sound_sweeps_of_sensors_with_few_beams_are_not_bad(lidar, beams):
    """Their rings look higher up than those of a thinned HDL-64E: more trees and poles."""
    config = SimulationConfig(lidar=lidar, camera=False, image_size=(32, 32), seed=32)
    limits = shipped_limits("png", beams).lidar
    sweeps = [simulate_frame(config, index).points for index in range(8)]
    assert not [check for check in map(check_lidar, sweeps) if limits.judge(check).is_alarm]


def test_a_dirty_lens_is_no_jpeg_and_what_is_given_is_taken():
    dirty = [find_kind("camera_dirt").at(4)(sound(), np.random.default_rng(n)) for n in range(3)]
    assert choose_shipped(check_frames(dirty)).limits == read_limits()
    given = choose_shipped(checks(92, 2), images="png", beams=64)
    assert given.limits == read_limits()
    assert given.warnings == ()


def test_most_sweeps_tell_the_number_of_beams():
    some = checks().lidar * 3 + checks(every=2).lidar * 3
    assert choose_shipped(DriveChecks(camera=(), lidar=some)).limits == read_limits()


@pytest.mark.parametrize(
    ("rings", "beams"),
    [(10, 16), (14, 16), (15, 16), (17, 32), (19, 32), (24, 32)],  # VLP-16: 14, 15; HDL-32E: 17..
)
def test_the_number_of_beams_is_told_by_the_rings_ahead(rings, beams):
    lidar = tuple(each._replace(ringless=-np.log2(rings)) for each in checks().lidar)
    chosen = choose_shipped(DriveChecks(camera=(), lidar=lidar))
    assert chosen.limits == shipped_limits("png", beams)
    (told,) = chosen.warnings
    assert f"judged as of {beams} beams; if your LiDAR has another number, set --lidar-b" in told


def test_limits_fitted_to_the_first_frames_fit_sensors_of_any_make():
    def odd(sample):
        grainy = with_image(sample, lambda image: cv2.GaussianBlur(image, (0, 0), 2))
        return with_points(grainy, lambda points: points * np.float32([1, 1, 1, 0.05]))

    frames = [odd(sound(n % 2)) for n in range(MIN_FIRST_FRAMES)]
    seen = check_frames(frames)
    base = choose_shipped(seen)
    assert HealthMonitor(base.limits)(frames[0]).worst_score < 0.5
    fitted = fit_to_first(base, seen)
    health = HealthMonitor(fitted.limits)(frames[0])
    assert min(health.camera.score, health.lidar.score) > 0.5
    assert "assumed to be sound" in fitted.warnings[-1]
    black = with_image(frames[0], np.zeros_like)
    assert HealthMonitor(fitted.limits)(black).camera.is_alarm


def test_a_sensor_that_delivers_nothing_in_the_first_frames_keeps_its_limits():
    lidar_only = replace(checks(), camera=(), lidar=checks().lidar * MIN_FIRST_FRAMES)
    base = choose_shipped(lidar_only)
    fitted = fit_to_first(base, lidar_only)
    assert fitted.limits.camera == base.limits.camera
    assert fitted.limits.lidar != base.limits.lidar
    for wrong in (checks(), DriveChecks(camera=(), lidar=())):
        with pytest.raises(ValueError, match="at least 10 frames"):
            fit_to_first(base, wrong)


def test_the_yaw_is_told_where_limits_for_another_make_do_not_fit():
    sample = thinned(as_jpeg(sound(), 85), 2)
    health = HealthMonitor(read_limits())(sample)
    assert health.camera.is_alarm
    assert health.lidar.is_alarm
    assert health.alignment is None
    assert abs(health.yaw_deg) < 0.3


def test_a_lidar_without_reflectances_is_not_faded():
    plain = with_points(sound(), lambda points: points * np.float32([1, 1, 1, 0]))
    assert not HealthMonitor()(plain).lidar.is_alarm


def test_frames_in_which_a_sensor_delivered_nothing_are_not_looked_at():
    empty = replace(with_image(sound(), np.zeros_like), points=torch.zeros(0, 4))
    assert check_frames([empty, replace(empty, image=None, points=None)]) == DriveChecks(
        camera=(), lidar=()
    )

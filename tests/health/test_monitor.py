from dataclasses import replace

import numpy as np
import pytest
import torch

from sightline.corruptions.suites import find_suite
from sightline.health.fitting import fit_on_dataset, fit_on_samples
from sightline.health.monitor import HealthMonitor
from sightline.simulation.packaged import PACKAGED_FRAMES
from tests.health.frames import sound, with_image, with_points

MONITOR = HealthMonitor()


@pytest.mark.parametrize("index", [0, 1])
def test_sound_sensors_are_no_alarm(index):
    health = MONITOR(sound(index))
    assert not health.camera.is_alarm
    assert not health.lidar.is_alarm
    assert not health.alignment.is_alarm
    assert abs(health.yaw_deg) < 0.1
    assert health.camera_regions.mean() < 0.2
    assert health.worst_score == min(
        health.camera.score, health.lidar.score, health.alignment.score
    )


def test_absent_sensors_are_a_result():
    nothing = MONITOR(replace(sound(), image=None, points=None))
    for health in (nothing.camera, nothing.lidar):
        assert (health.score, health.worst_check) == (0.0, "absent")
    assert nothing.alignment is None
    assert nothing.yaw_deg is None
    assert nothing.camera_regions.all()
    assert nothing.lidar_regions.all()
    half = MONITOR(replace(sound(), image=None))
    assert half.lidar == MONITOR(sound()).lidar
    assert half.worst_score == 0


def test_faults_of_one_sensor_leave_the_score_of_the_other():
    clean = MONITOR(sound())
    for case in find_suite("dgfn7-figure").cases:
        broken = MONITOR(case.corrupt(sound()).sample)
        for name in ("camera", "lidar"):
            if name not in case.corruption.sensors:
                assert getattr(broken, name) == getattr(clean, name)
            elif case.name in ("camera_blank", "lidar_blank", "camera_noise", "camera_occlusion"):
                assert getattr(broken, name).is_alarm


def test_bad_sensors_say_nothing_of_the_alignment():
    dead = with_points(sound(), lambda points: points[:2])
    assert MONITOR(dead).lidar.score == 0
    assert MONITOR(dead).alignment is None
    assert MONITOR(with_image(sound(), np.zeros_like)).alignment is None


def test_samples_of_any_size_are_judged():
    sample = sound()
    tiny = replace(
        sample,
        image_size=(1, 1),
        image=torch.zeros(3, 1, 1, dtype=torch.uint8),
        points=torch.zeros(0, 4),
        depth=None,
        objects=None,
    )
    health = MONITOR(tiny)
    assert health.camera.is_alarm
    assert health.lidar.score == 0


def test_the_lidar_is_judged_alike_whatever_camera_there_is():
    sample = sound()
    expected = MONITOR(sample).lidar
    assert MONITOR(replace(sample, image=None)).lidar == expected
    smaller = replace(
        sample, image=sample.image[:, :200, :600].clone(), image_size=(200, 600), depth=None
    )
    assert MONITOR(smaller).lidar == expected


def test_limits_are_fitted_on_frames_that_have_both_sensors():
    with pytest.raises(ValueError, match="lacks a sensor"):
        fit_on_samples([replace(sound(), image=None)], {})
    with pytest.raises(ValueError, match="at least 100 clean frames, got 2"):
        fit_on_dataset(PACKAGED_FRAMES)
    with pytest.raises(ValueError, match="at least 100 clean frames, got -1"):
        fit_on_dataset(PACKAGED_FRAMES, frames=-1)
    with pytest.raises(ValueError, match="seed must not be negative, got -1"):
        fit_on_dataset(PACKAGED_FRAMES, seed=-1)
    blind = with_image(sound(), lambda image: np.full_like(image, 90))
    with pytest.raises(ValueError, match="0 of 100 frames show edges"):
        fit_on_samples([replace(blind, points=torch.ones(500, 4))] * 100, {})


def test_limits_that_were_fitted_judge_what_they_were_fitted_on():
    limits = fit_on_samples([sound(0), sound(1)] * 50, {"data": "two frames"})
    monitor = HealthMonitor(limits)
    assert not monitor(sound(0)).camera.is_alarm
    assert not monitor(sound(1)).lidar.is_alarm

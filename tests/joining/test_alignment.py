import dataclasses

import numpy as np
import pytest
import torch

import sightline.joining.alignment as module
from sightline.augmentation.sample_changes import rotate_extrinsics
from sightline.data.open import open_dataset
from sightline.joining.alignment import (
    Alignment,
    AlignmentConfig,
    Measured,
    evenly_spread,
    measure_alignment,
    measure_angles,
)
from sightline.joining.recording import distinct_scenes, measure_recording
from sightline.simulation.packaged import PACKAGED_FRAMES
from sightline.structures.lidar_turn import LidarTurn
from tests.joining.scenes import make_sample

SIMULATED = AlignmentConfig(yaw_bias_deg=0.0)


@pytest.fixture(scope="module")
def recording():
    """Six frames, of two streets."""
    dataset = open_dataset(PACKAGED_FRAMES)
    return [dataset[index % 2] for index in range(6)]


def measured(monkeypatch, **changes):
    """Let a measurement be given, of a LiDAR turned by 1 degree with KITTI's biases."""
    turn = LidarTurn(yaw_deg=0.87, pitch_deg=0.16, roll_deg=0.4)
    given = Measured(turn=turn, noise_deg=(0.02, 0.0, 0.0), yaw_spread_deg=0.1)._replace(**changes)
    monkeypatch.setattr(module, "measure_angles", lambda _: given)
    return measure_alignment([make_sample()] * 5)


def test_the_rotation_of_a_recording_is_measured(recording):
    turned = [rotate_extrinsics(sample, 1.0) for sample in recording]
    found = measure_alignment(turned, SIMULATED)
    assert not found.by_boxes
    assert found.turn.yaw_deg == pytest.approx(1.0, abs=0.1)


def test_a_sound_recording_has_nothing_to_undo(recording):
    found = measure_alignment(recording, SIMULATED)
    assert found == Alignment()
    assert str(found).startswith("nothing to align: the LiDAR fits the calibration")


def test_frames_of_a_standing_vehicle_show_one_scene(recording):
    noise = torch.Generator().manual_seed(0)

    def jittered(sample):
        levels = sample.image + 4 * torch.randn(sample.image.shape, generator=noise)
        return dataclasses.replace(sample, image=levels.clamp(0, 255).to(torch.uint8))

    standing = [jittered(recording[index // 5]) for index in range(10)]
    kept = distinct_scenes(standing)
    assert len(kept) == 2
    assert kept[0] is standing[0]
    assert kept[1] is standing[5]
    without = [dataclasses.replace(each, image=None) for each in standing]
    assert distinct_scenes(without) == without


def test_nothing_is_known_of_a_standing_vehicle_s_rotation(recording):
    def detect(_):
        raise AssertionError("there are two scenes alone")

    turned = [rotate_extrinsics(sample, 1.0) for sample in recording]
    assert measure_recording(turned, detect, SIMULATED) == Alignment()


def test_a_blank_camera_or_too_few_frames_tell_nothing(recording):
    blank = [dataclasses.replace(each, image=torch.zeros_like(each.image)) for each in recording]
    assert measure_angles(blank) is None
    assert measure_angles(recording[:4]) is None
    assert measure_alignment(blank) is None
    assert measure_alignment(recording[:4]) is None


def test_the_bias_of_sound_data_is_taken_off(monkeypatch):
    found = measured(monkeypatch)
    assert found.turn.yaw_deg == pytest.approx(1.0)
    assert (found.turn.pitch_deg, found.turn.roll_deg) == (0.0, 0.0)  # within their limits


def test_angles_within_their_noise_stay(monkeypatch):
    assert not measured(monkeypatch, noise_deg=(0.35, 0.0, 0.0)).turn


def test_angles_beyond_the_search_stay(monkeypatch):
    assert not measured(monkeypatch, turn=LidarTurn(yaw_deg=3.9, pitch_deg=3.2, roll_deg=1.6)).turn


def test_frames_that_do_not_agree_are_aligned_by_their_boxes(monkeypatch):
    assert measured(monkeypatch, yaw_spread_deg=0.5) == Alignment(by_boxes=True)


def test_frames_are_spread_over_the_recording():
    assert evenly_spread(3) == [0, 1, 2]
    assert evenly_spread(0) == []
    spread = evenly_spread(1000)
    assert (len(spread), spread[0], spread[-1]) == (15, 0, 999)
    assert np.ptp(np.diff(spread)) <= 1

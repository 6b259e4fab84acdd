"""Graded health: exact values on made images and points, and its fall for every kind."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from sightline.augmentation.faults import fault_rng
from sightline.augmentation.sample_changes import crop
from sightline.corruptions.corruption import Corrupted, NoCorruption
from sightline.corruptions.drawing import CorruptionSampler
from sightline.corruptions.kinds import KINDS, SEVERITIES
from sightline.data.open import open_dataset
from sightline.detection2d.examples import ExampleConfig, ViewConfig, training_example
from sightline.detection2d.graded_health import camera_health, lidar_health, with_point_health
from sightline.detection2d.placement import camera_image
from sightline.simulation.packaged import PACKAGED_FRAMES

SIZE = (64, 96)
LOST_BY_CHANCE = {"camera_blank", "lidar_blank"}


@pytest.fixture(scope="module")
def picture():
    generator = torch.Generator().manual_seed(0)
    return 0.3 + 0.4 * torch.rand(3, *SIZE, generator=generator)


@pytest.fixture(scope="module")
def sample():
    """A part of a packaged frame, for speed."""
    return crop(open_dataset(PACKAGED_FRAMES)[0], 120, 400, 240, 480)


def mean(health):
    return float(health[~health.isnan()].mean())


def noise(picture, sigma):
    generator = torch.Generator().manual_seed(1)
    return picture + sigma * torch.randn(picture.shape, generator=generator)


def test_a_sound_image_has_health_1_and_a_blank_one_0(picture):
    sound, blank = (
        camera_health(picture, each, SIZE) for each in (picture, torch.zeros_like(picture))
    )
    assert torch.allclose(sound, torch.ones(1, 8, 12), atol=1e-5)
    assert torch.allclose(blank, torch.zeros(1, 8, 12), atol=1e-6)


def test_noise_as_strong_as_the_signal_leaves_a_half(picture):
    sigma = float(picture.std())
    assert mean(camera_health(picture, noise(picture, sigma), SIZE)) == pytest.approx(0.5, abs=0.03)
    assert mean(camera_health(picture, noise(picture, 2 * sigma), SIZE)) == pytest.approx(
        0.2, abs=0.03
    )


def test_a_brighter_or_darker_image_is_sound_until_it_sinks_in_the_noise(picture):
    assert mean(camera_health(picture, picture + 0.2, SIZE)) == pytest.approx(1, abs=1e-4)
    assert mean(camera_health(picture, 0.5 * picture, SIZE)) > 0.9
    assert mean(camera_health(picture, 0.02 * picture, SIZE)) < 0.1


def test_damage_is_local(picture):
    broken = picture.clone()
    broken[:, :, :48] = 0
    health = camera_health(picture, broken, SIZE)
    assert health[:, :, :5].max() < 1e-5
    assert health[:, :, 7:].min() > 0.999


def test_cells_without_detail_or_beyond_the_image_are_unknown(picture):
    flat = picture.clone()
    flat[:, :, :40] = 0.5
    health = camera_health(flat, flat, (64, 128))
    assert health.shape == (1, 8, 16)
    assert health[:, :, :4].isnan().all()
    assert health[:, :, 12:].isnan().all()
    assert not health[:, :, 6:12].isnan().any()


def corrupted_sweep(sample, points, sources):
    nothing = NoCorruption().corrupt(sample, np.random.default_rng(0))
    return replace(nothing, sample=replace(sample, points=points), point_sources=sources)


def test_points_keep_1_lose_half_at_30_cm_and_all_where_lost_and_false_ones_count_0(sample):
    sound = replace(sample, points=sample.points[:3])
    given = sound.points[[0, 1, 1]].clone()
    given[1, 2] += 0.3
    valued = with_point_health(sound, corrupted_sweep(sound, given, torch.tensor([0, 1, -1])))
    assert valued.points[:, 3].tolist() == pytest.approx([1, 0.5, 0, 0], abs=1e-5)
    assert torch.equal(valued.points[:3, :3], sound.points[:, :3])


def test_cells_hold_the_mean_of_their_points_and_nothing_without_points(sample):
    points = sample.points[:1].repeat(4, 1)
    points[:, :3] = torch.tensor([20.0, 0.0, -1.0])
    points[:, 3] = torch.tensor([1.0, 0.5, 0.0, 0.0])
    health = lidar_health(replace(sample, points=points), (256, 480))
    assert health.shape == (1, 32, 60)
    assert health[~health.isnan()].tolist() == pytest.approx([0.375])


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in LOST_BY_CHANCE])
def test_health_falls_with_the_severity_of_every_kind(sample, kind):
    sensor = "lidar" if kind.startswith(("lidar", "misalignment")) else "camera"
    means = []
    for severity in (1, 3, 5):
        found = KINDS[kind].at(severity).corrupt(sample, fault_rng(sample, 0, kind))
        means.append(mean(health_of(sensor, sample, found)))
    assert 1 >= means[0] > means[1] > means[2] >= 0
    assert means[0] - means[2] > 0.01


def health_of(sensor, sample, found: Corrupted):
    size = (256, 480)
    if sensor == "camera":
        return camera_health(camera_image(sample), camera_image(found.sample), size)
    return lidar_health(with_point_health(sample, found), size)


@pytest.mark.parametrize("kind", sorted(LOST_BY_CHANCE))
def test_a_lost_picture_or_sweep_has_health_0(sample, kind):
    found = KINDS[kind].at(SEVERITIES[-1]).corrupt(sample, fault_rng(sample, 0, kind))
    assert mean(health_of(kind.partition("_")[0], sample, found)) == 0


def example(sample, *, graded, case="clean", suite="all"):
    config = ExampleConfig(
        crop_size=(128, 256),
        view=ViewConfig(scales=(0.7, 1.3)),
        cases=CorruptionSampler(suite=suite, probabilities={case: 1.0}),
        health=True,
        graded=graded,
    )
    return training_example(sample, config, (), np.random.default_rng(3))


def test_examples_hold_graded_health_and_the_same_images_as_without(sample):
    plain = example(sample, graded=False, case="camera_gaussian_noise-3")
    graded = example(sample, graded=True, case="camera_gaussian_noise-3")
    assert torch.equal(plain.image, graded.image)
    assert torch.equal(plain.lidar, graded.lidar)
    assert plain.camera_health.isnan().all()  # broken, but how much is left is not known
    assert graded.camera_health.shape == plain.camera_health.shape
    assert 0 < mean(graded.camera_health) < 0.9
    assert mean(graded.lidar_health) == 1


def test_sound_examples_have_health_1_in_every_view(sample):
    graded = example(sample, graded=True)
    assert mean(graded.camera_health) == pytest.approx(1, abs=1e-4)
    assert mean(graded.lidar_health) == 1


def test_a_camera_missing_in_the_data_has_health_0(sample):
    graded = example(replace(sample, image=None), graded=True)
    assert set(graded.camera_health.unique().tolist()) == {0.0}


def test_graded_needs_health():
    with pytest.raises(ValueError, match="set health to true"):
        ExampleConfig(graded=True)

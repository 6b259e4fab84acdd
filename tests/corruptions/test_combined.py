import pickle

import numpy as np
import pytest
import torch

from sightline.corruptions.combined import Combined
from sightline.corruptions.generate import corrupt_dataset
from sightline.corruptions.kinds import find_kind
from sightline.corruptions.suites import CLEAN, find_suite
from sightline.data.open import open_dataset
from sightline.simulation.packaged import PACKAGED_FRAMES


@pytest.fixture(scope="module")
def sample():
    return open_dataset(PACKAGED_FRAMES)[0]


def corrupted(sample, *names, severity=3):
    parts = tuple(find_kind(name).at(severity) for name in names)
    together = Combined(parts=parts)
    return together, together.corrupt(sample, np.random.default_rng(7))


def test_each_sensor_is_broken_as_its_own_kind_breaks_it(sample):
    together, both = corrupted(sample, "lidar_point_drop", "camera_jpeg")
    drop_rng, jpeg_rng = np.random.default_rng(7).spawn(2)
    drop, jpeg = together.parts
    assert torch.equal(both.sample.image, jpeg(sample, jpeg_rng).image)
    assert torch.equal(both.sample.points, drop(sample, drop_rng).points)
    assert together.kind == "lidar_point_drop+camera_jpeg"
    assert set(together.sensors) == {"camera", "lidar"}
    assert {name.split(".")[0] for name in both.record.parameters} <= set(together.kind.split("+"))


def test_a_new_generator_of_the_seed_repeats_a_result_and_a_used_one_gives_another(sample):
    together, first = corrupted(sample, "lidar_point_drop", "camera_gaussian_noise")
    rng = np.random.default_rng(7)
    again, another = (together.corrupt(sample, rng).sample for _ in range(2))
    assert torch.equal(again.image, first.sample.image)
    assert not torch.equal(another.image, again.image)


def test_points_are_followed_through_all_parts_of_one_sensor(sample):
    together, both = corrupted(sample, "lidar_point_drop", "lidar_gaussian_noise", "lidar_fog")
    assert together.sensors == ("lidar",)
    assert len(both.point_sources) == len(both.sample.points)
    stayed = both.point_sources >= 0
    sound = sample.points[both.point_sources[stayed]]
    changed = (both.sample.points[stayed] != sound).any(dim=1)
    delivered = torch.zeros(len(sample.points), dtype=torch.bool)
    delivered[both.point_sources[stayed]] = True
    assert both.broken_points[~delivered].all()
    assert torch.equal(both.broken_points[both.point_sources[stayed]], changed)
    outside = ~both.camera_mask
    assert torch.equal(both.sample.image[:, outside], sample.image[:, outside])


def test_a_dead_sensor_before_another_fault_stays_dead(sample):
    _, both = corrupted(sample, "lidar_blank", "lidar_rain", severity=5)
    assert both.sample.points is None or not (both.point_sources >= 0).any()


def test_kinds_at_once_are_a_suite_by_their_names():
    suite = find_suite("camera_fog+lidar_fog")
    assert suite.case_names == (CLEAN, *(f"camera_fog+lidar_fog-{level}" for level in range(1, 6)))
    assert suite.kinds == ("camera_fog+lidar_fog",)
    assert [case.corruption.sensors for case in suite.cases[1:]] == [("camera", "lidar")] * 5
    again = pickle.loads(pickle.dumps(suite.cases[3]))
    assert again.corruption.described() == suite.cases[3].corruption.described()
    assert find_suite("lidar_fog").kinds == ("lidar_fog",)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("fogs", "there is no suite 'fogs'"),
        ("camera_fog+fogs", "there is no kind of corruption 'fogs'"),
        ("camera_fog+camera_fog", "camera_fog is named twice"),
        ("camera_fog+", "there is no kind of corruption ''"),
    ],
)
def test_a_suite_of_unknown_kinds_is_refused_by_name(name, message):
    with pytest.raises(ValueError, match=message):
        find_suite(name)
    with pytest.raises(ValueError, match="two or more kinds, got 1"):
        Combined(parts=(find_kind("camera_fog").at(1),))


def test_corrupt_writes_cases_of_several_kinds(tmp_path):
    suite = "camera_jpeg+lidar_point_drop"
    out = tmp_path / "cases"
    corrupt_dataset(PACKAGED_FRAMES, out, suite=suite, cases=[f"{suite}-2"], workers=1)
    broken, sound = open_dataset(out / f"{suite}-2")[0], open_dataset(PACKAGED_FRAMES)[0]
    assert len(broken.points) < len(sound.points)
    assert not torch.equal(broken.image, sound.image)

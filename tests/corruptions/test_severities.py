"""Levels of severities: their documented values and their monotonic effect."""

import dataclasses

import numpy as np
import pytest
import torch

from sightline.augmentation.faults import fault_rng
from sightline.augmentation.sample_changes import crop
from sightline.corruptions.kinds import KINDS, SEVERITIES, find_kind
from sightline.corruptions.sensor import HDL_32E
from sightline.corruptions.suites import SUITES
from sightline.data.datasets.kitti_object import KittiObjectDataset
from sightline.simulation.packaged import PACKAGED_FRAMES
from tests.data.scenes import sample_of

LOST_M = 5.0  # displacement that a lost point or a ghost counts as


def damage(sound, corrupted):
    """Levels by which the image has changed, and metres by which points have moved, on average."""
    image = (corrupted.sample.image.int() - sound.image.int()).abs().double().mean()
    if corrupted.point_sources is None:
        return float(image)
    kept = corrupted.point_sources >= 0
    away = torch.full((len(sound.points),), LOST_M)
    rows = corrupted.point_sources[kept]
    moved = corrupted.sample.points[kept, :3] - sound.points[rows, :3]
    away[rows] = moved.norm(dim=1).clamp(max=LOST_M)
    ghosts = LOST_M * float((~kept).sum())
    return float(image) + (float(away.sum()) + ghosts) / len(sound.points)


@pytest.fixture(scope="module")
def street():
    return crop(KittiObjectDataset(PACKAGED_FRAMES)[0], 60, 400, 240, 480)


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
def test_each_severity_is_worse_than_the_one_before(kind, street):
    found = np.zeros(5)
    for seed in range(3):
        for severity in SEVERITIES:
            rng = fault_rng(street, seed, kind.name)
            found[severity - 1] += damage(street, kind.at(severity).corrupt(street, rng))
    assert (np.diff(found) >= -0.005 * found[:-1]).all(), found
    assert found[4] > 1.05 * found[0] > -1
    if not kind.name.endswith("_blank"):  # frames are lost at random
        assert found[0] > 0


def sweep_of_32_beams():
    rng = np.random.default_rng(0)
    elevations = np.radians(np.repeat(HDL_32E.beam_elevations_deg, 40))
    azimuths = np.tile(np.radians(np.linspace(-38, 38, 40)), 32)
    ranges = rng.uniform(5, 60, 1280)
    flat = ranges * np.cos(elevations)
    rows = (flat * np.cos(azimuths), flat * np.sin(azimuths), ranges * np.sin(elevations))
    return torch.from_numpy(np.stack((*rows, rng.random(1280)), axis=1).astype(np.float32))


@pytest.mark.parametrize("kind", [k for k in KINDS.values() if "lidar" in k.at(1).sensors])
def test_a_sensor_of_32_beams_is_changed_by_each_kind(kind):
    sample = sample_of(points=sweep_of_32_beams())
    corruption = kind.at(5 if kind.name == "lidar_blank" else 1, HDL_32E)
    found = corruption.corrupt(sample, fault_rng(sample, 0, kind.name))
    assert found.broken_points.any() or (found.point_sources < 0).any()
    if kind.name == "lidar_beams":
        assert len(found.record.parameters["beams"]) == 24
        assert len(found.sample.points) == 24 * 40


def test_the_levels_are_those_that_are_documented():
    assert KINDS["camera_fog"].levels == ((200,), (100,), (60,), (40,), (25,))
    assert KINDS["lidar_fog"].at(5).attenuation_per_m == 0.06
    assert KINDS["misalignment_spatial"].at(3).rotation_deg == 1
    assert KINDS["lidar_impulse_noise"].at(1).share == pytest.approx(1 / 30)
    assert KINDS["camera_gaussian_noise"].at(1).sigma_levels == pytest.approx((20.4, 20.4))
    text = "radius 70 px, ghosts 0.02 of the points"
    assert KINDS["sun_glare"].describe(5) == text
    with pytest.warns(DeprecationWarning, match="call Kind.describe"):
        assert KINDS["sun_glare"].said(5) == text
    assert len(KINDS) == 34


def test_core_and_all_hold_each_kind_at_five_severities():
    for name in ("core", "all"):
        suite = SUITES[name]
        kinds = [kind for kind in KINDS.values() if kind.is_core or name == "all"]
        assert suite.kinds == tuple(kind.name for kind in kinds)
        assert suite.case_names[1:] == tuple(f"{k.name}-{s}" for k in kinds for s in SEVERITIES)
        for case in suite.cases[1:]:
            assert case.corruption == KINDS[case.kind].at(case.severity)
            assert case.corruption.kind == case.kind
            assert case.probability == pytest.approx(1 / len(suite.cases))
    assert {case.severity for case in SUITES["dgfn7"].cases} == {None}


def test_a_kind_stands_for_its_severities_and_can_be_left_out():
    core = SUITES["core"]
    assert [c.name for c in core.select(["lidar_fog", "clean"])] == [
        "clean",
        *(f"lidar_fog-{s}" for s in SEVERITIES),
    ]
    rest = core.without(["lidar_fog"])
    assert {case.kind for case in rest} == {"none", *core.kinds} - {"lidar_fog"}


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: find_kind("camera_fogg"), "perhaps camera_fog or .* is meant"),
        (lambda: find_kind("fog"), "perhaps camera_fog or lidar_fog is meant"),
        (lambda: find_kind("camera_fog").at(6), "camera_fog has severities from 1 to 5, got 6"),
        (lambda: SUITES["core"].select(["lidar_fogg-3"]), "perhaps lidar_fog-3 or"),
        (lambda: SUITES["core"].select(["lidar_fog-9"]), "perhaps lidar_fog-.* KIND-1 to KIND-5"),
        (lambda: SUITES["core"].without(["lidar_fgo"]), "no kind 'lidar_fgo'; perhaps lidar_fog"),
    ],
)
def test_what_there_is_not_is_refused_with_the_nearest_names(call, message):
    with pytest.raises(ValueError, match=message) as error:
        call()
    assert "\n" not in str(error.value)


def test_a_kind_that_gives_something_else_than_it_did_is_told_from_what_it_was():
    snow = KINDS["lidar_snow"].at(1)
    assert snow.described()["revision"] == type(snow).revision == 2
    assert "revision" not in KINDS["lidar_beams"].at(1).described()  # as in the first records


def test_each_corruption_can_be_recorded_and_refuses_settings_out_of_range():
    for kind in KINDS.values():
        corruption = kind.at(3)
        for field in dataclasses.fields(corruption):
            if isinstance(getattr(corruption, field.name), float):
                with pytest.raises(ValueError, match=field.name):
                    dataclasses.replace(corruption, **{field.name: float("nan")})

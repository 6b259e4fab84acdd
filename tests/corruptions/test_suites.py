from collections import Counter

import jsonargparse
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from sightline.augmentation.faults import Fault
from sightline.corruptions.blank import CameraBlank
from sightline.corruptions.corruption import NoCorruption
from sightline.corruptions.drawing import CorruptionSampler
from sightline.corruptions.noise import CameraDeadPixels, CameraGaussianNoise
from sightline.corruptions.suites import CLEAN, SUITES, Case, Suite, find_suite
from tests.corruptions.samples import same
from tests.data.scenes import few, sample_of, seeds

DGFN7 = SUITES["dgfn7"]


def test_dgfn7_has_the_rows_of_table_1_of_kim_et_al_but_for_their_mean():
    assert [(case.name, case.title) for case in DGFN7.cases] == [
        ("clean", "Lidar + RGB (normal)"),
        ("camera_blank", "Lidar + RGB (blank)"),
        ("lidar_blank", "Lidar (blank) + RGB"),
        ("camera_occlusion", "Lidar + RGB (occlusion)"),
        ("lidar_occlusion", "Lidar (occlusion) + RGB"),
        ("camera_noise", "Lidar + RGB (noise)"),
        ("camera_illumination", "Lidar + RGB (illumination)"),
    ]
    for case in DGFN7.cases[1:]:
        assert case.corruption.sensors == (case.name.split("_")[0],)


def test_both_readings_of_the_noise_are_suites():
    assert DGFN7.select(["camera_noise"])[0].corruption == CameraGaussianNoise()
    (figure_case,) = SUITES["dgfn7-figure"].select(["camera_noise"])
    assert figure_case.corruption == CameraDeadPixels(share=(0.63, 0.63))
    others = [name for name in DGFN7.case_names if name != "camera_noise"]
    assert SUITES["dgfn7-figure"].select(others) == DGFN7.select(others)


@pytest.mark.parametrize("suite", SUITES.values(), ids=SUITES)
def test_every_suite_begins_with_sound_sensors_and_is_found_by_its_name(suite):
    assert suite.cases[0].name == CLEAN
    assert isinstance(suite.cases[0].corruption, NoCorruption)
    assert find_suite(suite.name) is suite


@few
@given(order=st.permutations(range(4)), case=st.sampled_from(DGFN7.cases), seed=st.integers(0, 99))
def test_what_a_sample_meets_in_a_test_does_not_depend_on_the_others(order, case, seed):
    samples = [sample_of(number) for number in range(4)]
    alone = [case.corrupt(sample, seed) for sample in samples]
    for number in order:
        found = case.corrupt(samples[number], seed)
        assert same(found.sample, alone[number].sample)
        assert found.record == alone[number].record


def test_samples_seeds_and_kinds_draw_differently():
    occluded = DGFN7.select(["camera_occlusion"])[0]
    found = [occluded.corrupt(sample_of(number), seed) for number in (0, 1) for seed in (0, 1)]
    assert len({each.record.parameters["box_px"] for each in found}) == 4
    on_lidar = DGFN7.select(["lidar_occlusion"])[0].corrupt(sample_of(0), 0)
    assert on_lidar.record.parameters != found[0].record.parameters


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: find_suite("dgfn"), "no suite 'dgfn'; perhaps dgfn7 is meant; name one of dgfn7,"),
        (
            lambda: find_suite("x\n"),
            r"no suite 'x\\n'; name one of dgfn7, dgfn7-figure, core, all, a kind, or kinds",
        ),
        (lambda: DGFN7.select(["clean", "camera_blak"]), "perhaps camera_blank is meant"),
        (lambda: DGFN7.select(["lidar_beams-5"]), "camera_illumination; suite core has it$"),
        (lambda: CorruptionSampler(suite="dgfn"), "perhaps dgfn7 is meant"),
        (
            lambda: CorruptionSampler(probabilities={"lidar_blnk": 1.0}),
            "perhaps lidar_blank is meant",
        ),
        (lambda: CorruptionSampler(probabilities={"clean": 0.5}), "sum to 1, got {'clean': 0.5}"),
        (
            lambda: CorruptionSampler(probabilities={"clean": 2.0, "lidar_blank": -1.0}),
            "at least 0",
        ),
        (lambda: CorruptionSampler(probabilities={}), "sum to 1, got {}"),
        (lambda: CorruptionSampler(probabilities={"clean": float("nan")}), "sum to 1, got"),
    ],
)
def test_what_there_is_not_is_refused_with_the_nearest_names(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_a_suite_that_contradicts_itself_is_refused():
    case = Case(name="clean", title="sound", corruption=NoCorruption(), probability=0.5)
    with pytest.raises(ValueError, match="a name for each case, got"):
        Suite(name="two", cases=(case, case))
    with pytest.raises(ValueError, match=r"sum to 1, got 0\.5"):
        Suite(name="half", cases=(case,))
    other = Case(name="blank", title="", corruption=CameraBlank(), probability=0.5)
    for cases in ((), (other,), (other, case)):
        with pytest.raises(ValueError, match=r"needs .* sound sensors as its first case.*'clean'"):
            Suite(name="unheld", cases=cases)
    assert Suite(name="whole", cases=(case, other)).case_names == ("clean", "blank")


@pytest.mark.parametrize("name", ["../evil", "a/b", "", ".", "\x1b[31m", "x" * 300])
def test_a_case_whose_folder_would_have_another_name_is_refused(name):
    with pytest.raises(ValueError, match=r"^suite: the name of case .* expected a plain file"):
        Case(name=name, title="", corruption=CameraBlank())


def test_a_suite_that_no_training_draws_from_needs_no_probabilities():
    cases = tuple(
        Case(name=name, title=name, corruption=corruption)
        for name, corruption in (("clean", NoCorruption()), ("blank", CameraBlank()))
    )
    assert Suite(name="mine", cases=cases).case_names == ("clean", "blank")


@pytest.mark.parametrize(
    ("probabilities", "expected"),
    [
        (None, (0.2, 0.1, 0.1, 0.1, 0.1, 0.2, 0.2)),  # five operations, then the sensor
        ({"clean": 0.75, "lidar_blank": 0.25}, (0.75, 0, 0.25, 0, 0, 0, 0)),
    ],
)
@pytest.mark.parametrize("per", ["image", "update"])
def test_cases_are_drawn_for_training_as_often_as_set(probabilities, expected, per):
    drawing = CorruptionSampler(probabilities=probabilities, per=per)
    rng = np.random.default_rng(0)
    counts = Counter(drawing.draw(rng)[0].name for _ in range(4000))
    shares = [counts[name] / 4000 for name in DGFN7.case_names]
    np.testing.assert_allclose(shares, expected, atol=0.025)


@given(seed=seeds, num_images=st.integers(1, 9))
def test_the_images_of_an_update_share_a_case_only_where_that_is_set(seed, num_images):
    drawn = CorruptionSampler(per="update").draw(np.random.default_rng(seed), num_images)
    assert len(drawn) == num_images
    assert len(set(drawn)) == 1
    assert drawn[0] == CorruptionSampler(per="update").draw(np.random.default_rng(seed))[0]
    assert len(CorruptionSampler().draw(np.random.default_rng(seed), num_images)) == num_images


def test_images_have_cases_of_their_own_by_default():
    drawn = CorruptionSampler().draw(np.random.default_rng(0), 200)
    assert {case.name for case in drawn} == set(DGFN7.case_names)


def test_unseen_kinds_are_never_drawn_and_a_kind_can_be_drawn_at_all_severities():
    rng = np.random.default_rng(0)
    drawn = CorruptionSampler(suite="core", without=("lidar_fog", "sun_glare")).draw(rng, 2000)
    kinds = {case.kind for case in drawn}
    assert kinds == {"none", *SUITES["core"].kinds} - {"lidar_fog", "sun_glare"}
    half = CorruptionSampler(suite="core", probabilities={"clean": 0.5, "lidar_fog": 0.5})
    counts = Counter(case.name for case in half.draw(rng, 2000))
    assert set(counts) == {"clean", *(f"lidar_fog-{severity}" for severity in range(1, 6))}
    assert counts["clean"] == pytest.approx(1000, abs=100)
    with pytest.raises(ValueError, match="no case is left to draw; set other probabilities"):
        CorruptionSampler(suite="camera_fog+lidar_fog")
    for name in ("lidar_fog", "lidar_fog-3"):
        shares, without = {"clean": 0.2, name: 0.8, "sun_glare": 0}, ("sun_glare", "lidar_fog")
        with pytest.raises(ValueError, match=f"^{name} has the probability 0.8, and `without` l"):
            CorruptionSampler(suite="core", probabilities=shares, without=without)
    with pytest.raises(ValueError, match="no kind 'lidar_fgo'; perhaps lidar_fog"):
        CorruptionSampler(suite="core", without=("lidar_fgo",))


def test_a_recipe_can_set_how_cases_are_drawn():
    parser = jsonargparse.ArgumentParser(exit_on_error=False)
    parser.add_argument("--drawing", type=CorruptionSampler, default=CorruptionSampler())
    given = {"drawing": {"probabilities": {"clean": 0.5, "lidar_blank": 0.5}, "per": "update"}}
    found = parser.instantiate(parser.parse_object(given)).drawing
    expected = CorruptionSampler(probabilities={"clean": 0.5, "lidar_blank": 0.5}, per="update")
    assert found == expected


def test_a_drawn_case_is_applied_with_the_generator_that_drew_it():
    sample, found = sample_of(), []
    for _ in range(2):
        rng = np.random.default_rng(5)
        (case,) = CorruptionSampler(probabilities={"camera_noise": 1.0}).draw(rng)
        found.append(case.corruption(sample, rng).image)
    assert torch.equal(*found)
    assert not torch.equal(found[0], sample.image)


@pytest.mark.parametrize("case", DGFN7.cases, ids=lambda case: case.name)
def test_each_kind_can_be_a_fault_in_a_recipe(case):
    parser = jsonargparse.ArgumentParser(exit_on_error=False)
    parser.add_argument("--fault", type=Fault)
    kind = type(case.corruption)
    named = parser.parse_args([f"--fault={kind.__module__}.{kind.__name__}"])
    assert parser.instantiate(named).fault == case.corruption

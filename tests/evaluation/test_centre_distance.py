"""nuScenes' scores by centre distance: against slow loops, and trap by trap."""

import csv
import json
import math
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import assume, given, settings

from sightline.cli.main import main
from sightline.evaluation.kitti_object import compare_objects, evaluate_objects
from sightline.evaluation.kitti_object_rules import DIFFICULTIES
from tests.evaluation.kitti_scenes import (
    MISSING,
    Line,
    random_crowd,
    random_street,
    submissions,
    text_of,
    write_frames,
)
from tests.reference import centre_distance as reference
from tests.reference import kitti_object as kitti_reference

CAR = Line()
FOUND = replace(CAR, score=0.5)
CARS, CARS_BY_HAND = ("Car", "3d", "hard"), ("Car", 2)


def evaluate(files, **options):
    """Scores of the 3D entries, by class and difficulty."""
    with TemporaryDirectory() as folder:
        results, labels = write_frames(Path(folder), files)
        report = evaluate_objects(results, labels, **options)
    assert all(entry.centres is None for entry in report.entries if entry.metric != "3d")
    return {(e.class_name, e.difficulty): e.centres for e in report.entries if e.metric == "3d"}


def easy(labels, found):
    """The scores of one frame with cars at the easy level."""
    return evaluate([(text_of(labels), text_of(found))])["Car", "easy"]


def errors(scores):
    found = (scores.translation_error_m, scores.scale_error, scores.orientation_error_rad)
    return None if found == (None, None, None) else list(found)


def assert_equal(found, files):
    for (name, difficulty), scores in found.items():
        minimum = kitti_reference.STRICT[name][2]
        level = DIFFICULTIES.index(difficulty)
        expected = reference.scores(files, name, level, minimum=minimum)
        if expected is None:
            assert scores is None
            continue
        mean, by_distance, true_positive_errors = expected
        assert scores.ap == pytest.approx(mean, abs=1e-9), (name, difficulty)
        assert list(scores.ap_at) == pytest.approx(by_distance, abs=1e-9), (name, difficulty)
        assert errors(scores) == pytest.approx(true_positive_errors, abs=1e-9), (name, difficulty)


@settings(max_examples=100)
@given(files=submissions())
def test_any_scene_gives_the_scores_that_the_rules_give_by_hand(files):
    assume(not kitti_reference.Evaluation(files).is_ambiguous())
    assert_equal(evaluate(files), files)


@pytest.mark.parametrize("seed", range(3))
def test_many_frames_give_the_scores_that_the_rules_give_by_hand(seed):
    files = random_street(seed, num_frames=60)
    found = evaluate(files)
    assert_equal(found, files)
    scores = found["Car", "moderate"]
    assert 0 < scores.ap_at[0] <= scores.ap_at[2] < 100
    assert 0 < scores.translation_error_m < 2


@pytest.mark.parametrize("seed", range(2))
def test_crowds_full_of_ties_give_the_scores_that_the_rules_give_by_hand(seed):
    files = random_crowd(seed, num_frames=100)
    assert_equal(evaluate(files), files)


def test_perfect_results_score_100_without_errors_however_few():
    scores = easy([CAR], [FOUND])
    assert scores.ap == pytest.approx(100)
    assert scores.ap_at == pytest.approx((100, 100, 100, 100))
    assert errors(scores) == [0, 0, 0]
    assert scores.ap_2m == scores.ap_at[2]


@pytest.mark.parametrize(
    ("moved_m", "found_at"),
    [(0.49, 4), (0.5, 3), (0.99, 3), (1, 2), (2, 1), (3.99, 1), (4, 0)],
)
def test_a_distance_equal_to_the_limit_is_no_match(moved_m, found_at):
    scores = easy([CAR], [FOUND.moved(ground=moved_m)])
    assert scores.ap_at == pytest.approx((0,) * (4 - found_at) + (100,) * found_at)
    assert scores.ap == pytest.approx(25 * found_at)


def test_height_does_not_count_and_depth_does():
    assert easy([CAR], [replace(FOUND, y=CAR.y + 3)]).ap == pytest.approx(100)
    assert easy([CAR], [replace(FOUND, z=CAR.z + 4)]).ap == 0


def test_errors_are_of_centre_aligned_size_and_heading():
    found = replace(FOUND.moved(ground=1.5), z=CAR.z + 1, l=CAR.l / 2, ry=math.pi + 0.25)
    scores = easy([CAR], [found])
    assert scores.translation_error_m == pytest.approx(math.hypot(1.5, 1))
    assert scores.scale_error == pytest.approx(0.5)
    assert scores.orientation_error_rad == pytest.approx(math.pi - 0.25)


def test_each_recall_position_has_the_mean_error_of_the_objects_found_so_far():
    labels = [CAR.moved(image=200 * place, ground=20 * place) for place in range(2)]
    found = [replace(labels[0], score=2), replace(labels[1].moved(ground=1), score=1)]
    # up to half of the recall the first alone counts, 0 m; then to the mean of both, 0.5 m, in line
    means = [0 if k <= 50 else 0.5 * (k - 50) / 50 for k in range(11, 101)]
    assert easy(labels, found).translation_error_m == pytest.approx(sum(means) / 90)


def test_the_best_score_takes_the_nearest_object_that_is_left():
    labels = [CAR, CAR.moved(image=200, ground=1.5)]
    between = FOUND.moved(ground=0.9, score=1)  # nearer to the second
    first = FOUND.moved(ground=0.1, score=0.5)
    scores = easy(labels, [between, first])
    assert scores.ap_at[1] == pytest.approx(100)
    second = FOUND.moved(ground=1.4, score=0.5)
    scores = easy(labels, [between, second])  # takes what is left, 1.4 m away
    assert scores.ap_at[1] < 50
    assert scores.ap_at[2] == pytest.approx(100)


def test_a_second_detection_of_an_object_is_false():
    scores = easy([CAR, CAR.moved(image=200, ground=30)], [FOUND, replace(FOUND, score=0.9)])
    # precision falls from 1 at half of the recall, where the last of both detections counts: 0.5
    assert scores.ap == pytest.approx(100 * (39 * 0.9 + 0.4) / 90 / 0.9)


def test_precision_is_interpolated_between_recalls_and_less_than_a_tenth_is_nothing():
    far = [FOUND.moved(ground=10 + place, score=9) for place in range(9)]
    assert easy([CAR], [*far, FOUND]).ap == pytest.approx(
        100 * sum(max(0, 0.1 * k / 100 - 0.1) for k in range(11, 101)) / 90 / 0.9
    )


def test_recall_up_to_a_tenth_gives_no_ap_and_no_errors():
    labels = [CAR.moved(image=100 * place, ground=10 * place) for place in range(10)]
    scores = easy(labels, [FOUND])
    assert (scores.ap, errors(scores)) == (0, None)
    two = easy(labels, [FOUND, replace(labels[1], score=0.4)])
    assert two.ap == pytest.approx(100 * 10 / 90)
    assert errors(two) == [0, 0, 0]


def test_harder_objects_and_vans_may_be_found_and_are_never_missed():
    for other in (
        CAR.moved(image=300, ground=30, name="Van"),
        CAR.moved(image=300, ground=30, occlusion=2),
        CAR.moved(image=300, ground=30, truncation=0.2),
    ):
        found_other = replace(other, name="Car", score=0.9)
        assert easy([CAR, other], [FOUND]).ap == pytest.approx(100)
        assert easy([CAR, other], [FOUND, found_other]).ap == pytest.approx(100)
        assert easy([CAR], [FOUND, found_other]).ap < 100
        again = [replace(found_other, score=0.8)]  # each may be found once only
        assert easy([CAR, other], [FOUND, found_other, *again]).ap < 100


def test_a_detection_too_small_for_the_difficulty_takes_no_part():
    small = {"y2": CAR.y1 + 39}
    assert easy([CAR], [FOUND, replace(FOUND.moved(ground=30), score=1, **small)]).ap == (
        pytest.approx(100)
    )
    assert easy([CAR], [replace(FOUND, **small), FOUND.moved(ground=60)]).ap == 0


def test_another_class_is_never_matched():
    person = replace(CAR, name="Pedestrian")
    scores = evaluate([(text_of([CAR, person]), text_of([FOUND.moved(ground=30), replace(
        person, score=1, name="Car")]))])  # fmt: skip
    assert scores["Car", "easy"].ap > 0
    assert ("Pedestrian", "easy") not in scores
    alone = evaluate([(text_of([person]), FOUND.text())])
    assert alone["Car", "easy"] is None


def test_a_region_forgives_in_space_only_as_in_the_3d_score():
    false = replace(FOUND.moved(ground=30), score=0.9)
    in_image = replace(CAR, name="DontCare", **MISSING)
    in_space = replace(CAR.moved(ground=30), name="DontCare")
    assert easy([CAR, in_image], [FOUND, false]).ap == easy([CAR], [FOUND, false]).ap < 100
    assert easy([CAR, in_space], [FOUND, false]).ap == pytest.approx(100)


def test_an_object_without_a_3d_part_matches_nothing():
    assert easy([CAR, CAR.moved(**MISSING)], [FOUND]).ap < 60
    flat = replace(FOUND, h=0, score=0.9)
    assert easy([CAR], [FOUND, flat]).ap < 100


def test_bands_of_distance_score_their_own_objects(tmp_path):
    far = replace(CAR, z=50)
    frames = [(text_of([CAR, far]), text_of([FOUND, replace(far, score=0.9).moved(ground=5)]))]
    report = evaluate_objects(*write_frames(tmp_path, frames), by_distance=(30.0,))
    near_band, far_band = (
        [e.centres for e in band.entries if e.metric == "3d"] for band in report.bands
    )
    assert near_band[0].ap == pytest.approx(100)
    assert far_band[0].ap == 0


def test_intervals_are_those_of_scoring_every_resample_anew(tmp_path):
    frames = random_street(5, num_frames=10)
    fewer = [(label, "".join(found.splitlines(True)[::2])) for label, found in frames]
    (tmp_path / "fewer").mkdir()
    results, labels = write_frames(tmp_path, frames)
    against, _ = write_frames(tmp_path / "fewer", fewer)
    options = {"bootstrap": 8, "seed": 4}
    report = evaluate_objects(results, labels, **options)
    compared = compare_objects(results, labels, against, **options)
    at = next(
        place
        for place, each in enumerate(compared.entries)
        if (each.class_name, each.metric, each.difficulty) == CARS
    )
    generator = np.random.default_rng(4)
    drawn = [np.bincount(generator.integers(10, size=10), minlength=10) for _ in range(8)]
    rows = [
        [by_hand(files, weights.tolist()) for files in (frames, fewer)]
        for weights in (np.ones(10, dtype=int), *drawn)
    ]
    rows = [row for row in rows if None not in row]  # resamples without any car
    assert len(rows) > 5
    low, high = np.quantile([row[0][0] for row in rows[1:]], (0.025, 0.975))
    alone = report.entries[at].centres
    assert [alone.low, alone.high] == pytest.approx([low, high], abs=1e-9)
    pairs = (compared.entries[at].centre, compared.entries[at].centre_2m)
    for column, pair in enumerate(pairs):
        difference, *resampled = (row[0][column] - row[1][column] for row in rows)
        assert pair.difference == pytest.approx(difference, abs=1e-9)
        ends = np.quantile(resampled, (0.025, 0.975))
        assert [pair.low, pair.high] == pytest.approx(ends, abs=1e-9)
        assert pair.first == pytest.approx(rows[0][0][column], abs=1e-9)
        assert pair.low < pair.high


def by_hand(files, repeats):
    """Mean AP and that at 2 m of all cars, frames counted several times; None without any."""
    scores = reference.scores(files, *CARS_BY_HAND, repeats)
    return None if scores is None else (scores[0], scores[1][2])


def test_the_command_prints_and_writes_them(tmp_path, capsys):
    results, labels = write_frames(tmp_path, [(CAR.text(), FOUND.moved(ground=0.75).text())] * 10)
    files = {kind: tmp_path / f"scores.{kind}" for kind in ("json", "csv", "markdown")}
    command = ["evaluate", "objects", str(results), str(labels), "--bootstrap", "3"]
    for kind, path in files.items():
        command += [f"--{kind}", str(path)]
    assert main(command) == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["Car", "centre", "AP", "0.5-4", "m", "75.00", "75.00", "75.00"] in lines
    assert ["95", "%", "interval", "75.0-75.0", "75.0-75.0", "75.0-75.0"] in lines
    assert ["translation,", "m", "0.75", "0.75", "0.75"] in lines
    entries = json.loads(files["json"].read_text())["entries"]
    found = [entry["centre_distance"] for entry in entries]
    assert found[:6] == [None] * 6
    assert found[6] == {
        "AP": pytest.approx(75),
        "AP_95": pytest.approx([75, 75]),
        "AP_by_distance": pytest.approx({"0.5": 0, "1": 100, "2": 100, "4": 100}),
        "translation_error_m": pytest.approx(0.75),
        "scale_error": 0,
        "orientation_error_rad": 0,
    }
    with files["csv"].open() as file:
        rows = list(csv.DictReader(file))
    assert {row["AP_centre"] for row in rows if row["metric"] != "3d"} == {""}
    for row in rows[6:]:
        assert float(row["AP_centre"]) == pytest.approx(75)
        assert float(row["AP_centre_low"]) == float(row["AP_centre_high"]) == pytest.approx(75)
        assert float(row["AP_centre_2m"]) == pytest.approx(100)
        assert float(row["translation_error_m"]) == pytest.approx(0.75)
        assert float(row["scale_error"]) == float(row["orientation_error_rad"]) == 0
    assert "AP_centre_2m | translation_error_m" in files["markdown"].read_text()


def test_the_command_prints_differences_and_writes_them(tmp_path, capsys):
    (tmp_path / "other").mkdir()
    results, labels = write_frames(tmp_path, [(CAR.text(), FOUND.text())] * 10)
    moved = FOUND.moved(ground=0.75).text()
    against, _ = write_frames(tmp_path / "other", [(CAR.text(), moved)] * 10)
    file = tmp_path / "differences.json"
    command = ["evaluate", "objects", str(results), str(labels), "--against", str(against)]
    assert main([*command, "--bootstrap", "3", "--json", str(file)]) == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["0.5-4", "m,", "difference", "+25.00", "+25.00", "+25.00"] in lines
    entries = json.loads(file.read_text())["entries"]
    assert [entry["AP_centre"] is None for entry in entries] == [True] * 6 + [False] * 3
    assert entries[6]["AP_centre"]["difference"] == pytest.approx(25)
    assert entries[6]["AP_centre_2m"]["difference_95"] == [0, 0]

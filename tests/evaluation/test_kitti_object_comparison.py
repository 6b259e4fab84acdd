import json
import shutil
from dataclasses import replace

import pytest

from sightline.cli.main import main
from sightline.evaluation.kitti_object import compare_objects, evaluate_objects
from tests.evaluation.kitti_scenes import Line, random_street, write_frames
from tests.reference.paired_bootstrap import paired_interval

CAR = Line()
FOUND = replace(CAR, score=0.5)


@pytest.fixture
def street(tmp_path):
    """Results and labels of frames, and other results that lack some and move others."""
    frames = random_street(3, num_frames=12)
    other = [
        "".join(line for place, line in enumerate(found.splitlines(True)) if (place + number) % 3)
        for number, (_, found) in enumerate(frames)
    ]
    (tmp_path / "other").mkdir()
    folders = write_frames(tmp_path, frames)
    against, _ = write_frames(
        tmp_path / "other", [(label, text) for (label, _), text in zip(frames, other, strict=True)]
    )
    return folders, against, frames, other


def test_differences_and_intervals_are_those_of_scoring_every_resample_from_its_files(street):
    (results, labels), against, frames, other = street
    compared = compare_objects(results, labels, against, bootstrap=12, seed=4)
    chosen = {("Car", "bbox", "moderate"), ("Pedestrian", "bev", "hard"), ("Cyclist", "3d", "easy")}
    seen = 0
    for entry in compared.entries:
        name, metric, difficulty = entry.class_name, entry.metric, entry.difficulty
        if (name, metric, difficulty) not in chosen or entry.n_gt == 0:
            continue
        seen += 1
        level = ("easy", "moderate", "hard").index(difficulty)
        texts = [label for label, _ in frames], [found for _, found in frames], other
        difference, low, high = paired_interval(
            *texts, name, metric, level, num_resamples=12, seed=4
        )
        for column, pair in enumerate((entry.r40, entry.all_points)):
            assert pair.difference == pytest.approx(difference[column], abs=1e-9)
            assert pair.low == pytest.approx(low[column], abs=1e-9)
            assert pair.high == pytest.approx(high[column], abs=1e-9)
    assert seen >= 2


def test_each_side_of_a_comparison_has_the_scores_that_it_has_alone(street):
    (results, labels), against, *_ = street
    compared = compare_objects(results, labels, against, bootstrap=3)
    for folder, side in ((results, "first"), (against, "second")):
        alone = {
            (e.class_name, e.metric, e.difficulty): e
            for e in evaluate_objects(folder, labels).entries
        }
        for entry in compared.entries:
            expected = alone[entry.class_name, entry.metric, entry.difficulty]
            assert entry.n_gt == expected.n_gt
            if entry.n_gt:
                assert getattr(entry.r40, side) == pytest.approx(expected.ap_r40, abs=1e-9)
                points = getattr(entry.all_points, side)
                assert points == pytest.approx(expected.all_points.ap, abs=1e-9)


def test_a_submission_differs_from_itself_by_nothing_in_every_resample(street):
    (results, labels), *_ = street
    for entry in compare_objects(results, labels, results, bootstrap=20).entries:
        for pair in filter(None, (entry.r40, entry.all_points)):
            assert (pair.difference, pair.low, pair.high) == (0, 0, 0)


def test_the_same_results_under_two_names_are_told(street, tmp_path):
    (results, labels), against, *_ = street
    copied = tmp_path / "copied"
    shutil.copytree(results, copied)
    for folder in (results, copied):
        notes = compare_objects(results, labels, folder, bootstrap=2).notes()
        assert any("hold the same results to the byte" in note for note in notes)
    notes = compare_objects(results, labels, against, bootstrap=2).notes()
    assert not any("hold the same" in note for note in notes)


def test_resamples_that_all_miss_the_only_object_give_no_interval(tmp_path):
    frames = [(CAR.text(), FOUND.text())] + [("", "")] * 9
    folders = write_frames(tmp_path, frames)
    one = {"bootstrap": 1, "seed": 6}  # which draws the other nine frames
    content = compare_objects(*folders, folders[0], **one).to_json()
    assert content["entries"][0]["AP_R40"]["difference_95"] is None
    points = evaluate_objects(*folders, **one).entries[0].all_points
    assert (points.ap, points.low, points.high) == (100, None, None)


def test_a_seed_gives_the_same_intervals_again_and_another_one_others(street):
    (results, labels), against, *_ = street
    first, again, other = (
        compare_objects(results, labels, against, bootstrap=20, seed=seed).to_json()["entries"]
        for seed in (1, 1, 2)
    )
    assert first == again
    assert first != other


def test_a_class_that_one_submission_lacks_counts_as_not_found(tmp_path):
    folders = write_frames(tmp_path, [(CAR.text(), FOUND.text())] * 10)
    (tmp_path / "other").mkdir()
    against, _ = write_frames(tmp_path / "other", [(CAR.text(), "")] * 10)
    compared = compare_objects(*folders, against, bootstrap=5)
    entry = compared.entries[0]
    assert (entry.all_points.first, entry.all_points.second, entry.all_points.low) == (100, 0, 100)
    assert any("hold no object at all" in note for note in compared.notes())
    assert any("10 of Car, easy" in note for note in compared.notes())


def test_few_frames_have_differences_and_no_interval(tmp_path, capsys):
    (tmp_path / "other").mkdir()
    for count, has_interval in ((2, False), (9, False), (10, True)):
        results, labels = write_frames(tmp_path, [(CAR.text(), FOUND.text())] * count)
        against, _ = write_frames(tmp_path / "other", [(CAR.text(), "")] * count)
        report = tmp_path / "differences.json"
        command = ["evaluate", "objects", str(results), str(labels), "--against", str(against)]
        assert main([*command, "--bootstrap", "5", "--json", str(report)]) == 0
        text = " ".join(capsys.readouterr().out.split())
        assert ("95 %" in text) == has_interval
        assert (f"at least 10 frames, got {count}" in text) != has_interval
        pair = json.loads(report.read_text())["entries"][0]["AP_all_points"]
        assert pair["difference"] == 100
        assert pair["difference_95"] == ([100, 100] if has_interval else None)


def test_the_command_prints_differences_and_writes_them(street, tmp_path, capsys):
    (results, labels), against, *_ = street
    report = tmp_path / "differences.json"
    command = ["evaluate", "objects", str(results), str(labels), "--against", str(against)]
    assert main([*command, "--bootstrap", "5", "--json", str(report)]) == 0
    text = capsys.readouterr().out
    assert all(word in text for word in ("R40, difference", "all points, difference", "95 %"))
    content = json.loads(report.read_text())
    assert content["resamples"] == 5
    assert {entry["metric"] for entry in content["entries"]} == {"bbox", "bev", "3d"}
    assert content["entries"][0]["AP_R40"].keys() == {
        "first", "second", "difference", "difference_95"
    }  # fmt: skip
    assert main([*command, "--plots", str(tmp_path / "plots")]) == 2
    assert "leave --by-distance, --csv" in capsys.readouterr().err
    assert main([*command, "--json", str(against / "000000.txt")]) == 2
    assert "among the input results" in capsys.readouterr().err


def test_a_comparison_without_resamples_is_refused(street):
    (results, labels), against, *_ = street
    with pytest.raises(ValueError, match="bootstrap must be positive to compare, got 0"):
        compare_objects(results, labels, against, bootstrap=0)

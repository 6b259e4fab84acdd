import csv
import json
import math
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from sightline.evaluation import kitti_object
from sightline.evaluation.kitti_object import evaluate_objects
from sightline.evaluation.kitti_object_matching import index_pairs, select
from sightline.evaluation.kitti_object_proposals import evaluate_proposals
from sightline.evaluation.kitti_object_resampling import ResampledCurve
from sightline.evaluation.kitti_object_rules import (
    LOOSE,
    STRICT,
    ClassOverlaps,
    MinimumOverlaps,
    parse_overlaps,
)
from sightline.evaluation.kitti_object_scores import score_objects
from sightline.evaluation.object_report import write_object_rows
from sightline.files.problem import FileError
from tests.evaluation.kitti_scenes import Line, random_crowd, random_street, text_of, write_frames
from tests.reference import kitti_object as reference

CAR = Line()
FOUND = replace(CAR, score=0.5)
KEYS = {
    "class",
    "metric",
    "difficulty",
    "n_gt",
    "max_recall",
    "AP_R11",
    "AP_R40",
    "AOS_R11",
    "AOS_R40",
    "precision",
    "thresholds",
    "tp",
    "fp",
    "fn",
    "flipped_share",
    "AP_all_points",
    "AP_all_points_95",
    "centre_distance",
}


@pytest.fixture
def street(tmp_path):
    return write_frames(tmp_path, random_street(3, num_frames=30))


def test_the_json_report_has_the_stated_shape(street):
    report = json.loads(json.dumps(evaluate_objects(*street).to_json()))
    assert report.keys() == {"frames", "frames_without_results", "notes", "entries"}
    assert report["frames"] == 30
    assert len(report["entries"]) == 27
    for entry in report["entries"]:
        assert entry.keys() == KEYS
        assert entry["class"] in ("Car", "Pedestrian", "Cyclist")
        assert entry["metric"] in ("bbox", "bev", "3d")
        assert entry["difficulty"] in ("easy", "moderate", "hard")
        assert len(entry["precision"]) == 41
        assert len(entry["tp"]) == len(entry["fp"]) == len(entry["fn"]) == len(entry["thresholds"])
        assert (entry["AOS_R40"] is None) == (entry["metric"] != "bbox")


def test_with_bootstrap_each_entry_has_the_area_and_its_interval(street):
    report = evaluate_objects(*street, bootstrap=20)
    for entry in report.to_json()["entries"]:
        assert entry.keys() == KEYS
        low, high = entry["AP_all_points_95"]
        assert 0 <= low <= high <= 100
        assert 0 <= entry["AP_all_points"] <= 100


def test_the_table_shows_every_figure_within_80_columns(street):
    console = Console(width=80, record=True)
    report = evaluate_objects(*street, bootstrap=5)
    console.print(report.table())
    text = console.export_text()
    assert "30 frames" in text
    assert "…" not in text
    words = text.split()
    for entry in report.entries:
        assert entry.class_name in words
        assert entry.metric in words
        assert f"{entry.ap_r40:.2f}" in words
        assert f"{entry.ap_r11:.2f}" in words
        assert f"{100 * entry.max_recall:.2f}" in words
        assert f"{entry.all_points.low:.1f}-{entry.all_points.high:.1f}" in words
    assert text.count("AOS R40") == 3


def test_the_area_counts_every_score_and_not_only_the_slots(tmp_path):
    # 3 of 4 cars found, the first detection false: precision 1/2, 2/3, 3/4 at recall 1/4, 2/4, 3/4
    labels = [CAR.moved(image=200 * place) for place in range(4)]
    found = [replace(line, score=5 - place) for place, line in enumerate(labels[:3])]
    found.append(FOUND.moved(image=900, score=9))
    folders = write_frames(tmp_path, [(text_of(labels), text_of(found))])
    entry = evaluate_objects(*folders).entries[0]
    assert entry.all_points.ap == pytest.approx(100 * 3 / 4 * 3 / 4)
    assert entry.ap_r40 < 10


def test_perfect_detections_have_an_area_of_100_however_few(tmp_path):
    folders = write_frames(tmp_path, [(CAR.text(), FOUND.text())] * 10)
    entry = evaluate_objects(*folders, bootstrap=50).entries[0]
    assert entry.all_points == replace(entry.all_points, ap=100.0, low=100.0, high=100.0)


@pytest.mark.parametrize(("count", "has_interval"), [(9, False), (10, True)])
def test_intervals_need_ten_frames(tmp_path, count, has_interval):
    folders = write_frames(tmp_path, [(CAR.text(), FOUND.text())] * count)
    report = evaluate_objects(*folders, bootstrap=50)
    for entry in report.to_json()["entries"]:
        assert entry["AP_all_points_95"] == ([100, 100] if has_interval else None)
    assert any("at least 10 frames, got 9" in note for note in report.notes()) != has_interval
    console = Console(width=80, record=True)
    console.print(report.table())
    assert ("95 % interval" in console.export_text()) == has_interval
    without = evaluate_objects(*folders)
    assert not any("resampling" in note for note in without.notes())


def test_without_objects_that_count_there_is_no_area(tmp_path):
    folders = write_frames(tmp_path, [("", FOUND.text())])
    report = evaluate_objects(*folders, bootstrap=3)
    assert report.to_json()["entries"][0]["AP_all_points"] is None
    assert report.to_json()["entries"][0]["AP_all_points_95"] is None


def test_equal_seeds_give_equal_intervals_and_others_differ(street):
    first, again, other = (
        evaluate_objects(*street, bootstrap=20, seed=seed).entries[0].all_points
        for seed in (1, 1, 2)
    )
    assert first == again
    assert first.ap == other.ap
    assert (first.low, first.high) != (other.low, other.high)


@pytest.mark.parametrize("make", [random_street, random_crowd])
def test_the_area_is_that_of_pass_2_at_every_score_for_any_resample(tmp_path, make, monkeypatch):
    files = make(5, 40)
    data = []
    monkeypatch.setattr(
        "sightline.evaluation.kitti_object.score_objects",
        lambda found, *_, **__: data.append(found) or score_objects(found, STRICT),
    )
    evaluate_objects(*write_frames(tmp_path, files))
    drawn = np.random.default_rng(0).integers(len(files), size=len(files))
    weights = np.bincount(drawn, minlength=len(files))
    task = select(data[0], index_pairs(data[0]), code=0, metric=0, difficulty=2, min_overlap=0.7)
    curve = ResampledCurve.of(task)
    area, r40 = curve.ap_all_points(weights), curve.ap_r40(weights)

    by_hand = reference.Evaluation([files[number] for number in drawn])
    frames = [
        reference.Frame(by_hand, truths, found, "Car", "bbox", 2)
        for truths, found in by_hand.frames
    ]
    scores = {each.score for frame in frames for each in frame.detections}
    counts = []
    for score in scores:
        passes = [frame.pass_2(score) for frame in frames]
        counts.append((sum(found[0] for found in passes), sum(found[1] for found in passes)))
    n_gt = sum(frame.truth_kinds.count("valid") for frame in frames)
    assert area == pytest.approx(reference.all_points(counts, n_gt), abs=1e-9)
    assert area > 5
    assert r40 == pytest.approx(by_hand.score("Car", "bbox", 2, False).ap_r40, abs=1e-9)


def test_a_missing_result_file_is_an_error_that_names_the_frame(street):
    results, labels = street
    (results / "000007.txt").unlink()
    with pytest.raises(ValueError, match=r"no result file for 1 of 30 frames, .* 000007\.txt: w"):
        evaluate_objects(results, labels)


@pytest.mark.parametrize("missing_as_empty", [False, True])
def test_result_files_that_end_in_capitals_are_told_not_taken_as_missing(street, missing_as_empty):
    results, labels = street
    (results / "000007.txt").rename(results / "000007.TXT")
    told = r"1 file ends in capitals, such as 000007\.TXT; rename them to NAME\.txt"
    with pytest.raises(ValueError, match=told):
        evaluate_objects(results, labels, missing_as_empty=missing_as_empty)


def test_label_files_that_all_end_in_capitals_are_told(street):
    results, labels = street
    for path in labels.iterdir():
        path.rename(path.with_suffix(".TXT"))
    with pytest.raises(ValueError, match=r"30 files end in capitals, such as 000000\.TXT; rename"):
        evaluate_objects(results, labels)


def test_a_list_of_samples_evaluates_the_frames_that_it_names(street, tmp_path):
    results, labels = street
    for path in results.glob("00002*.txt"):
        path.unlink()
    listed = tmp_path / "some.txt"
    listed.write_text("000003\r\n\n000001\n")
    assert evaluate_objects(results, labels, sample_list=listed).frames == 2
    listed.write_text("000003\n000777\n")
    with pytest.raises(ValueError, match=r"no label file for 1 of 2 frames, .* 000777\.txt"):
        evaluate_objects(results, labels, sample_list=listed)


def test_folders_that_are_none_and_folders_without_labels_say_what_to_give(street, tmp_path):
    results, labels = street
    with pytest.raises(ValueError, match="nothing is no folder; give the folder of the res"):
        evaluate_objects(tmp_path / "nothing", labels)
    with pytest.raises(ValueError, match="nothing is no folder; give the folder of the labels"):
        evaluate_objects(results, tmp_path / "nothing")
    (tmp_path / "drive").mkdir()
    with pytest.raises(ValueError, match="has no label files"):
        evaluate_objects(results, tmp_path / "drive")
    (tmp_path / "drive" / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n")
    with pytest.raises(FileError, match=r"drive/poses\.txt: line 1 has 12 fields"):
        evaluate_objects(results, tmp_path / "drive")
    (labels / "train.txt").write_text("000001\n")  # a list of frames beside the labels
    with pytest.raises(FileError, match=r"train\.txt: line 1 has 1 fields"):
        evaluate_objects(results, labels)


@pytest.mark.parametrize("below", ["training/label_2", "labels"])
@pytest.mark.parametrize("times", ["times.txt", "Times.TXT", None])
def test_a_data_set_in_the_place_of_its_labels_is_told(tmp_path, below, times):
    (tmp_path / "results").mkdir()
    (tmp_path / "data" / below).mkdir(parents=True)
    if times is not None:
        (tmp_path / "data" / times).write_text("000000 0.1\n")
    with pytest.raises(ValueError, match=f"whose labels are in {tmp_path}/data/{below}; name"):
        evaluate_objects(tmp_path / "results", tmp_path / "data")


def test_the_times_of_a_recording_without_labels_are_no_label_file(tmp_path):
    (tmp_path / "results").mkdir()
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "times.txt").write_text("000000 0.1\n")
    with pytest.raises(ValueError, match=r"no label files .*; give KITTI's folder label_2"):
        evaluate_objects(tmp_path / "results", tmp_path / "data")


def test_a_number_of_resamples_that_cannot_be_is_refused(street):
    with pytest.raises(ValueError, match="must not be negative, got -1"):
        evaluate_objects(*street, bootstrap=-1)
    with pytest.raises(ValueError, match="must be at most 100,000, got 1000000000"):
        evaluate_objects(*street, bootstrap=10**9)


def test_a_negative_seed_is_refused(street):
    with pytest.raises(ValueError, match="seed must not be negative, got -4"):
        evaluate_objects(*street, bootstrap=1, seed=-4)


def test_overlaps_are_read_as_the_command_line_has_them():
    assert parse_overlaps("strict") == STRICT
    assert parse_overlaps("loose") == LOOSE
    own = parse_overlaps("Car=0.5,0.25,0.2; cyclist=0.1,0.2,0.3")
    assert own.as_array().tolist() == [[0.5, 0.25, 0.2], [0.5, 0.5, 0.5], [0.1, 0.2, 0.3]]


@pytest.mark.parametrize("text", ["", "lax", "car=0.5", "car=0.5,0.5,x", "tram=0.5,0.5,0.5"])
def test_overlaps_that_are_none_say_how_to_write_them(text):
    with pytest.raises(ValueError, match=r"car=0\.5,0\.25,0\.25"):
        parse_overlaps(text)


@pytest.mark.parametrize("value", [-0.1, 1.0, float("nan")])
def test_an_overlap_that_nothing_can_exceed_is_refused(value):
    with pytest.raises(ValueError, match="bev must be at least 0 and below 1"):
        MinimumOverlaps(car=ClassOverlaps(bbox=0.5, bev=value, box3d=0.5))


@pytest.mark.parametrize("evaluate", [evaluate_objects, evaluate_proposals])
def test_a_frame_with_far_too_many_results_and_labels_is_refused_by_name(tmp_path, evaluate):
    for folder, line, count in (("r", "Car" + 15 * " 1", 2001), ("l", "Car" + 14 * " 1", 1000)):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "000001.txt").write_text(count * f"{line}\n")
    with pytest.raises(
        ValueError, match=r"r/000001\.txt: holds 2,001 results for the 1,000 labels"
    ):
        evaluate(tmp_path / "r", tmp_path / "l")


def test_full_frames_score_the_same_whether_they_are_matched_together_or_one_by_one(
    street, monkeypatch
):
    together = evaluate_objects(*street).to_json()
    monkeypatch.setattr(kitti_object, "_MAX_PAIRS", 10_000)
    monkeypatch.setattr(kitti_object, "_FRAMES_AT_A_TIME", 1)
    assert evaluate_objects(*street).to_json() == together


def test_class_names_of_files_are_no_markup_in_the_notes(street, tmp_path):
    for path in street[0].glob("*.txt"):
        path.write_text(path.read_text().replace("Pedestrian", "<img/src=x|onerror=f()>"))
    document = tmp_path / "scores.md"
    write_object_rows(evaluate_objects(*street), markdown=document)
    text = document.read_text()
    assert "&lt;img/src=x\\|onerror" in text
    assert "<" not in text


def test_rows_for_spreadsheets_hold_what_the_report_says(street, tmp_path):
    for path in street[0].glob("*.txt"):
        located = [line for line in path.read_text().splitlines(True) if " -1000.0 " not in line]
        path.write_text("".join(located))
    report = evaluate_objects(*street, bootstrap=20, by_distance=(25.0,))
    table, document = tmp_path / "scores.csv", tmp_path / "scores.md"
    write_object_rows(report, csv=table, markdown=document)
    rows = list(csv.DictReader(table.read_text().splitlines()))
    assert len(rows) == len(report.entries) * 3
    entries = [*report.entries, *(each for band in report.bands for each in band.entries)]
    for row, entry in zip(rows, entries, strict=True):
        assert (row["class"], row["metric"]) == (entry.class_name, entry.metric)
        assert int(row["objects"]) == entry.n_gt
        assert float(row["AP_R40"]) == entry.ap_r40
        assert row["AOS_R40"] == ("" if entry.aos_r40 is None else str(entry.aos_r40))
        points = entry.all_points
        assert row["AP_all_points"] == ("" if points is None else str(points.ap))
    assert {row["distance"] for row in rows} == {"all", "0-25 m", "25 m on"}
    table_text, *notes = document.read_text().split("\n\n")
    assert [note.strip() for note in notes] == report.notes()
    lines = table_text.splitlines()
    assert len(lines) == len(rows) + 2
    assert {line.count("|") for line in lines} == {len(rows[0]) + 1}
    assert lines[2].split(" | ")[5] == f"{report.entries[0].ap_r40:.2f}"


def test_a_frame_without_results_may_be_taken_as_empty_and_is_told(street):
    results, labels = street
    (results / "000003.txt").write_text("")
    expected = evaluate_objects(results, labels)
    (results / "000003.txt").unlink()
    with pytest.raises(ValueError, match="--missing-as-empty"):
        evaluate_objects(results, labels)
    report = evaluate_objects(results, labels, missing_as_empty=True)
    assert report.frames_without_results == 1
    assert [e.to_json() for e in report.entries] == [e.to_json() for e in expected.entries]
    assert "1 frame had no result file" in printed(report)
    for path in results.glob("*.txt"):
        path.unlink()
    with pytest.raises(ValueError, match="no result file of any of 30 frames"):
        evaluate_objects(results, labels, missing_as_empty=True)


def test_where_nothing_was_found_at_all_the_table_says_so(tmp_path):
    report = evaluate_objects(*write_frames(tmp_path, [(text_of([CAR]), "")]))
    assert report.entries == ()
    assert "No result is of a scored class: nothing" in " ".join(printed(report).split())


def test_few_objects_cannot_fill_the_recall_positions_and_the_table_says_so(tmp_path):
    cars = [CAR.moved(image=200 * n, ground=10 * n) for n in range(4)]
    found = [replace(car, score=0.9 - 0.1 * n) for n, car in enumerate(cars)]
    report = evaluate_objects(*write_frames(tmp_path, [(text_of(cars), text_of(found))]))
    assert {round(entry.ap_r40, 6) for entry in report.entries} == {7.5}
    assert "4 of Car, easy, give R40 of at most 7.5" in " ".join(printed(report).split())


def test_bands_with_few_objects_are_told_below_their_table(tmp_path):
    cars = [CAR.moved(image=10 * n, ground=10 * n) for n in range(50)]
    cars = [replace(car, alpha=-math.atan2(car.x, car.z)) for car in cars]
    found = [replace(car, score=0.9 - n / 1000) for n, car in enumerate(cars)]
    folders = write_frames(tmp_path, [(text_of([*cars]), text_of(found))])
    near = min(math.hypot(car.x, car.z) for car in cars)
    report = evaluate_objects(*folders, by_distance=(near + 0.01,))
    assert not report.notes()
    assert "1 of Car, easy, give R40 of at most 0.0" in " ".join(printed(report).split())


def printed(report):
    console = Console(width=100)
    with console.capture() as captured:
        console.print(report.table())
    return captured.get()

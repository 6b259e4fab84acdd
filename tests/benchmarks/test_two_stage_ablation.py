"""The course's table and its differences, from result files whose scores are plain."""

import json

import pytest

from benchmarks.table_papers import two_stage, two_stage_differences
from benchmarks.two_stage_ablation import main

CAR = "Car 0.00 0 -1.50 300 150 400 220 1.5 1.6 {length} {x} 1.7 20.0 0.0"
NUM_FRAMES = 12


def write(folder, x, *, length=4.0, score=None):
    """One car in each frame, x metres to the right; results have a score."""
    folder.mkdir(parents=True)
    line = CAR.format(x=x, length=length) + ("" if score is None else f" {score}")
    for number in range(NUM_FRAMES):
        (folder / f"{number:06}.txt").write_text(f"{line}\n")


@pytest.fixture
def folders(tmp_path):
    """Cars that are missed, found at an IoU of 0.6 (3 of 5 metres shared), and found exactly."""
    write(tmp_path / "labels", 0.0)
    write(tmp_path / "results" / "first", 30.0, score=0.9)
    write(tmp_path / "results" / "baseline", 1.0, score=0.9)
    write(tmp_path / "results" / "improved", 0.0, score=0.9)
    return tmp_path / "results", tmp_path / "labels"


def record_of(capsys):
    return json.loads(capsys.readouterr().out.splitlines()[-1])


def test_each_row_and_each_difference_is_scored_at_both_overlaps(folders, capsys):
    main(*folders, resamples=20)
    record = record_of(capsys)
    assert record["frames"] == NUM_FRAMES
    assert record["published"] == {"iou": 0.5, "ap_r11": [81.34, 72.35, 71.11]}
    for row, by_iou in {
        "first": {"0.5": 0.0, "0.7": 0.0},
        "baseline": {"0.5": 100.0, "0.7": 0.0},
        "improved": {"0.5": 100.0, "0.7": 100.0},
    }.items():
        for iou, ap in by_iou.items():
            scores = record["rows"][row][iou]
            assert scores["ap_all_points"] == [ap] * 3
            assert scores["num_objects"] == [NUM_FRAMES] * 3
            assert scores["ap_all_points_95"] == [[ap, ap]] * 3
    gains = {
        (each["row"], each["less"], each["iou"]): each["all_points"]["difference"]
        for each in record["differences"]
        if each["difficulty"] == "moderate"
    }
    assert gains == {
        ("baseline", "first", 0.5): 100.0,
        ("baseline", "first", 0.7): 0.0,
        ("improved", "first", 0.5): 100.0,
        ("improved", "first", 0.7): 100.0,
        ("improved", "baseline", 0.5): 0.0,
        ("improved", "baseline", 0.7): 100.0,
    }


def test_the_tables_have_the_course_above_and_a_line_for_each_pair_and_difficulty(folders, capsys):
    main(*folders, resamples=20)
    record = record_of(capsys)
    head, course, *rows = two_stage(record)
    assert head[1:4] == ["R11, IoU 0.5", "R40, IoU 0.5", "all points, IoU 0.5, moderate"]
    assert course[1] == "81.34 / 72.35 / 71.11"
    assert [row[0] for row in rows] == [
        "first stage alone",
        "baseline (problem 1)",
        "improved (problem 2)",
    ]
    assert rows[1][3] == "100.0 [100.0, 100.0]"
    assert rows[1][6] == "0.0 [0.0, 0.0]"
    assert {len(row) for row in (head, course, *rows)} == {7}
    head, *rows = two_stage_differences(record)
    measures = ("R40", "all points")
    assert head[2:] == [f"{name}, IoU {iou}" for iou in (0.5, 0.7) for name in measures]
    assert len(rows) == 9
    last = ["improved (problem 2) less baseline (problem 1)", "hard"]
    assert rows[-1][:2] == last
    assert rows[-1][3] == "+0.0 [+0.0, +0.0]"
    assert rows[-1][5] == "+100.0 [+100.0, +100.0]"


def test_a_single_row_needs_no_others_and_a_missing_one_is_named(folders, capsys):
    main(*folders, rows=["baseline"], resamples=20)
    record = record_of(capsys)
    assert list(record["rows"]) == ["baseline"]
    assert two_stage_differences(record) == [two_stage_differences(record)[0]]
    (folders[0] / "improved").rename(folders[0] / "other")
    with pytest.raises(ValueError, match="has no folder improved; write it by `sightline reprod"):
        main(*folders, resamples=20)


def test_a_further_row_is_named_by_its_folder(folders, capsys):
    (folders[0] / "improved").rename(folders[0] / "baseline_with_AdamW")
    main(*folders, rows=["baseline", "baseline_with_AdamW"], resamples=20)
    record = record_of(capsys)
    assert [row[0] for row in two_stage(record)[2:]] == [
        "baseline (problem 1)",
        "baseline with AdamW",
    ]
    assert two_stage_differences(record)[1][0] == "baseline with AdamW less baseline (problem 1)"

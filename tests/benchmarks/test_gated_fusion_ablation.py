"""Comparison of networks over seeds on result files whose scores are plain."""

import json

import pytest

from benchmarks.gated_fusion_ablation import main
from sightline.corruptions.suites import find_suite

CAR = "Car 0.00 0 -1.50 {left} 150 {right} 220 1.5 1.6 3.9 0.0 1.7 20.0 0.0"
CASES = [case.name for case in find_suite("dgfn7").cases]
NUM_FRAMES = 12


def write(folder, left, *, score=None, frames=range(NUM_FRAMES)):
    """One car in each frame; results have a score, and are empty outside of `frames`."""
    folder.mkdir(parents=True)
    line = CAR.format(left=left, right=left + 100) + ("" if score is None else f" {score}")
    for number in range(NUM_FRAMES):
        (folder / f"{number:06}.txt").write_text(line + "\n" if number in frames else "")


@pytest.fixture
def results(tmp_path):
    """Networks `gated` that find all cars and `ones` that find none with the LiDAR blank."""
    write(tmp_path / "labels", 300)
    for seed in (0, 1):
        for case in CASES:
            write(tmp_path / "results" / f"gated-{seed}" / "gated" / case, 300, score=0.9)
            missed = case == "lidar_blank"
            folder = tmp_path / "results" / f"ones-{seed}" / "ones" / case
            write(folder, 600 if missed else 300, score=0.9)
    return tmp_path / "results", tmp_path / "labels"


def test_differences_by_case_and_their_mean_have_intervals(results, capsys):
    main(*results, resamples=20, workers=1)
    record = json.loads(capsys.readouterr().out.splitlines()[-1])
    rows = {
        row["case"]: row for row in record["rows"] if (row["class"], row["iou"]) == ("Car", 0.7)
    }
    assert list(rows) == ["full", *CASES]
    assert {row["class"] for row in record["rows"]} == {"Car"}
    assert record["seeds"] == {"gated": [0, 1], "ones": [0, 1]}
    for case in CASES:
        lost = 100.0 if case == "lidar_blank" else 0.0
        all_points = rows[case]["all_points"]
        assert all_points["scores"] == {"gated": 100.0, "ones": 100.0 - lost}
        assert all_points["differences"]["ones"] == {"by_seed": [lost] * 2, "interval": [lost] * 2}
    full = rows["full"]["all_points"]["differences"]["ones"]
    assert full["by_seed"] == pytest.approx([100 / 7] * 2)
    assert full["interval"] == pytest.approx([100 / 7] * 2)


def test_networks_without_a_common_seed_are_refused(results):
    (results[0] / "ones-0").rename(results[0] / "ones-7")
    (results[0] / "ones-1").rename(results[0] / "ones-8")
    with pytest.raises(ValueError, match="expected common ones with the first"):
        main(*results, resamples=20, workers=1)

"""Forged or damaged records, manifests and stored scores."""

import json
import re
import shutil
from dataclasses import replace

import pytest

from sightline.corruptions import suites
from sightline.robustness.bench import BenchSettings, run_bench
from sightline.robustness.compare import compare_runs
from sightline.robustness.record import read_record
from sightline.robustness.report import RobustnessReport
from sightline.robustness.results import score_results
from sightline.simulation.packaged import PACKAGED_FRAMES
from tests.robustness.runs import AP, LEVELS, record_of
from tests.robustness.tasks import OracleTask
from tests.robustness.test_results import SETTINGS, written  # noqa: F401 - a fixture

ESCAPES = "\x1b[31mred\x1b]0;title\x07\u202e\x9b2J"
FORGED = f"{ESCAPES}\n# forged\r\n<script>alert(1)</script> ![x](https://x.test) | \x00"


def check_clean(text, *, is_page=False):
    """Check that a text has no control characters and no forged lines or tags."""
    assert all(line.isprintable() for line in text.split("\n"))
    assert not any(line.lstrip().startswith("# forged") for line in text.split("\n"))
    assert "<script>alert" not in text
    assert is_page or "](" not in text


def check_report(folder):
    for name in ("robustness.md", "robustness.csv", "robustness.json"):
        text = (folder / name).read_text()
        assert all(line.isprintable() for line in text.split("\n")), name
    check_clean((folder / "robustness.md").read_text())
    check_clean((folder / "report.html").read_text(), is_page=True)


def test_texts_of_a_forged_record_are_one_line_each(tmp_path):
    record = record_of(AP, 90.0, {"fog": {1: 80.0}})
    (tmp_path / "a").mkdir()
    RobustnessReport(record=replace(record, notes=("sound",))).write(tmp_path / "a")
    content = json.loads((tmp_path / "a" / "robustness.json").read_text())
    content |= {
        "notes": [FORGED],
        "method": FORGED,
        "data": FORGED,
        "made_by": {FORGED: FORGED},
    }
    content["cases"]["fog-1"] |= {"title": FORGED, "kind": FORGED}
    content["figures"][0] |= {"title": FORGED, "unit": FORGED}
    (tmp_path / "forged.json").write_text(json.dumps(content))
    forged = read_record(tmp_path / "forged.json")
    (tmp_path / "b").mkdir()
    RobustnessReport(record=forged, baseline=forged).write(tmp_path / "b")
    check_report(tmp_path / "b")
    both = compare_runs([tmp_path / "forged.json"] * 2)
    both.write(tmp_path / "page.html")
    check_clean((tmp_path / "page.html").read_text(), is_page=True)


@pytest.mark.parametrize(
    "change",
    [
        {"notes": [1]},
        {"notes": [["nested"]]},
        {"notes": 3},
        {"notes": ["x" * 1_000_000]},
        {"method": None},
        {"method": "x" * 1_000_000},
        {"seed": 10**400},
        {"seed": -1},
        {"frames": True},
        {"frames": 1.5},
        {"figures": []},
        {"figures": {}},
        {"cases": []},
        {"scores": {"clean": {"ap": float("nan")}, "fog-1": {"ap": 1}}},
        {"scores": {"clean": {"ap": 10**400}, "fog-1": {"ap": 1}}},
        {"scores": {"clean": {"ap": "90"}, "fog-1": {"ap": 1}}},
        {"scores": {"clean": {"ap": [[[]]]}, "fog-1": {"ap": 1}}},
        {"scores": {"clean": {}}},
        {"scores": None},
    ],
    ids=lambda change: str(change)[:60],
)
def test_a_record_of_wrong_values_is_refused_in_one_line(tmp_path, change):
    RobustnessReport(record=record_of(AP, 90.0, {"fog": {1: 80.0}})).write(tmp_path)
    content = json.loads((tmp_path / "robustness.json").read_text()) | change
    (tmp_path / "forged.json").write_text(json.dumps(content))
    with pytest.raises(ValueError, match=r"forged\.json.*; give the robustness\.json") as caught:
        read_record(tmp_path / "forged.json")
    assert len(str(caught.value)) < 500
    assert str(caught.value).isprintable()


@pytest.mark.parametrize("lacking", ["method", "made_by", "task", "figures", "cases", "scores"])
def test_a_record_without_a_part_is_refused(tmp_path, lacking):
    RobustnessReport(record=record_of(AP, 90.0, {"fog": {1: 80.0}})).write(tmp_path)
    content = json.loads((tmp_path / "robustness.json").read_text())
    del content[lacking]
    (tmp_path / "forged.json").write_text(json.dumps(content))
    with pytest.raises(ValueError, match=f"is no record of a robustness run .*{lacking}"):
        read_record(tmp_path / "forged.json")


def forged_cases(written_cases, folder, **changes):
    shutil.copytree(written_cases, folder)
    manifest = json.loads((folder / "sightline.json").read_text()) | changes
    (folder / "sightline.json").write_text(json.dumps(manifest))
    return folder


def test_texts_of_a_forged_manifest_are_one_line_each(written, tmp_path):  # noqa: F811
    cases, found, _ = written
    forged = forged_cases(cases, tmp_path / "cases", data=FORGED)
    mine = tmp_path / "mine\x1b[31m\n# forged <script>alert(1)<"
    shutil.copytree(found, mine)
    score_results(OracleTask(), forged, mine, tmp_path / "out", SETTINGS)
    check_report(tmp_path / "out")


@pytest.mark.parametrize(
    "changes",
    [
        {"data": 1},
        {"data": "x" * 1_000_000},
        {"seed": 10**400},
        {"seed": True},
        {"seed": -1},
        {"seed": "0"},
        {"velodyne": FORGED},
        {"velodyne": []},
        {"suite": ["levels"]},
        {"cases": [1]},
    ],
    ids=lambda changes: str(changes)[:40],
)
def test_a_manifest_of_wrong_values_is_refused_in_one_line(written, tmp_path, changes):  # noqa: F811
    cases, found, _ = written
    forged = forged_cases(cases, tmp_path / "cases", **changes)
    with pytest.raises(ValueError, match="is no output of `sightline corrupt`; give") as caught:
        score_results(OracleTask(), forged, found, tmp_path / "out", SETTINGS)
    assert len(str(caught.value)) < 500
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "stored", ["", "null", "[]", "{}", '{"Car_bbox_0.7_easy_R40": NaN}', '{"a": 1}', "[" * 100_000]
)
def test_invalid_stored_scores_are_made_again(tmp_path, monkeypatch, stored):
    monkeypatch.setitem(suites.SUITES, "levels", LEVELS)
    settings = BenchSettings(workers=1, suite="levels", cases=("lidar_blank",))
    out = tmp_path / "out"
    run_bench(OracleTask(), PACKAGED_FRAMES, out, settings, method="oracle")
    before = (out / "robustness.json").read_bytes()
    (out / "scores" / "lidar_blank.json").write_text(stored)
    run_bench(OracleTask(), PACKAGED_FRAMES, out, settings, method="oracle")
    assert (out / "robustness.json").read_bytes() == before


def test_a_folder_that_is_called_as_no_case_is_reported_with_the_most_similar_case(
    written,  # noqa: F811
    tmp_path,
):
    cases, found, _ = written
    mine = tmp_path / "mine"
    shutil.copytree(found, mine)
    (mine / "camera_blank").rename(mine / "camera_blnk")
    (mine / "notes\x1b").mkdir()
    report = score_results(OracleTask(), cases, mine, tmp_path / "out", SETTINGS)
    assert report.no_cases == ("camera_blnk (perhaps camera_blank is meant)", "notes\\x1b")
    warning = (
        "WARNING: 2 folders of results named as no case of suite levels, not scored: camera_blnk"
    )
    assert any(note.startswith(warning) for note in report.notes())
    assert warning in (tmp_path / "out" / "robustness.md").read_text()
    content = json.loads((tmp_path / "out" / "robustness.json").read_text())
    assert content["folders_not_scored"] == list(report.no_cases)
    for path in mine.iterdir():
        if path.name not in ("clean", "camera_blnk"):
            shutil.rmtree(path)
    with pytest.raises(ValueError, match=re.escape("there is camera_blnk (perhaps camera_blank")):
        score_results(OracleTask(), cases, mine, tmp_path / "none", SETTINGS)

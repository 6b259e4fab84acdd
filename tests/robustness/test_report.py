"""Outputs of a run: tables, files and pages; and comparisons of runs."""

import csv
import io
import json
import math
import re
from dataclasses import replace
from html.parser import HTMLParser

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from sightline.cli.main import main
from sightline.files.problem import FileError
from sightline.robustness.charts import heat_color, nice_top, remaining_share
from sightline.robustness.compare import Comparison, compare_runs
from sightline.robustness.record import read_record
from sightline.robustness.report import RobustnessReport
from sightline.robustness.texts import TextTable
from tests.robustness.runs import AP, RMSE, record_of

TABLE = {"camera_fog": {1: 70.0, 3: 40.0}, "lidar_rain": {2: 77.0}}


def report_of(**other):
    record = record_of(AP, 80.0, TABLE)
    baseline = record_of(AP, 60.0, {"camera_fog": {1: 40.0, 3: 20.0}, "lidar_rain": {2: 54.0}})
    return RobustnessReport(record=record, baseline=baseline, **other)


def test_a_run_that_is_its_own_baseline_is_told():
    report = report_of()
    assert not any("baseline" in note for note in report.notes())
    assert replace(report, baseline=report.record).notes()[0].startswith("WARNING: the baseline is")


def text(report):
    console = Console(width=200)
    with console.capture() as captured:
        console.print(report.table())
    return captured.get()


class Page(HTMLParser):
    """Parts of a page to check; refuses tags that are not closed in order."""

    VOID = ("meta", "img", "br", "link")

    def __init__(self, content):
        super().__init__()
        self.open, self.links, self.words, self.tags = [], [], [], []
        self.feed(content)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.links += [value for name, value in attrs if name in ("src", "href")]
        if tag not in self.VOID and not self.get_starttag_text().endswith("/>"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        if self.get_starttag_text() and self.open and self.open[-1] == tag:
            self.open.pop()

    def handle_data(self, data):
        if self.open and self.open[-1] not in ("style", "script"):
            self.words.append(data)


def test_the_tables_say_what_was_measured_by_hand():
    shown = text(report_of())
    # mPC: ((70 + 40) / 2 + 77) / 2; RR of fog 55 / 80; CE of fog (30 + 60) / (60 + 80)
    assert re.search(r"camera fog +70\.0 +40\.0 +55\.0 +0\.69 +0\.64", shown)
    assert re.search(r"lidar rain +77\.0 +77\.0 +0\.96 +0\.50", shown)
    assert re.search(r"mean of kinds +66\.0 +0\.82 +0\.57", shown)
    assert re.search(r"average precision, % +80\.0 +66\.0 +0\.82 +0\.57 +40\.0 camera_fog-3", shown)


def test_a_run_leaves_a_record_that_reads_back_a_table_and_a_page(tmp_path):
    healthy = {"lidar": record_of(AP, 50.0, {})}
    report = report_of(healthy=healthy)
    report.write(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(report.files)
    assert read_record(tmp_path / "robustness.json") == report.record
    measures = json.loads((tmp_path / "robustness.json").read_text())["measures"]["ap"]
    assert measures["mPC"] == 66.0
    assert measures["gap"] == {"case": "camera_fog-3", "score": -10.0}
    rows = list(csv.DictReader(io.StringIO((tmp_path / "robustness.csv").read_text())))
    assert [row["case"] for row in rows] == list(report.record.cases)
    assert rows[1]["severity"] == "1"
    assert (rows[2]["score"], rows[2]["baseline"], rows[2]["gap"]) == ("40.0", "20.0", "-10.0")
    markdown = (tmp_path / "robustness.md").read_text()
    assert "| camera fog | 70.0 |  | 40.0 | 55.0 | 0.69 | 0.64 | -10.0 |" in markdown
    page = Page((tmp_path / "report.html").read_text())
    assert page.links == []  # nothing is fetched
    assert "svg" in page.tags
    assert {"70.0", "40.0", "camera fog", "66.0"} <= set(page.words)


@pytest.mark.parametrize(
    "change",
    [
        {"seed": "three"},
        {"frames": "inf"},
        {"scores": {"clean": {"ap": "high"}}},
        {"cases": {"clean": {"title": "", "kind": "clean", "severity": "x", "sensors": []}}},
        {"figures": [{"name": "ap", "title": "AP", "unit": "%", "highest": "a hundred"}]},
        {"figures": [{"name": "ap"}]},
        {"made_by": 3},
        {"cases": []},
    ],
)
def test_files_of_other_contents_are_refused_by_their_path_and_the_remedy(tmp_path, change):
    path = tmp_path / "robustness.json"
    report_of().write(tmp_path)
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    with pytest.raises(FileError, match=r"robustness\.json: is no record .* give the robustness"):
        read_record(path)


@given(share=st.floats(0, 1))
def test_every_share_has_a_colour(share):
    assert all(re.fullmatch("#[0-9a-f]{6}", color) for color in heat_color(share))


@given(value=st.floats(1e-6, 1e9))
def test_an_axis_ends_little_above_what_it_shows(value):
    assert value * (1 - 1e-6) <= nice_top(value) <= 2.5 * value * (1 + 1e-6)


def test_colours_tell_what_is_left_of_scores_and_of_errors_alike():
    assert remaining_share(40.0, 80.0, AP) == remaining_share(1600.0, 800.0, RMSE) == 0.5
    assert remaining_share(90.0, 80.0, AP) == 1
    assert remaining_share(0.0, 0.0, AP) is None
    assert remaining_share(0.0, 0.0, RMSE) == remaining_share(0.0, 800.0, RMSE) == 1
    assert remaining_share(None, 80.0, AP) is None


def test_scores_are_reported_even_where_no_clean_performance_could_be_lost(tmp_path):
    hopeless = record_of(AP, 0.0, {"camera_fog": {1: 12.5, 3: 0.0}})
    RobustnessReport(record=hopeless).write(tmp_path)
    assert '<td class="cell">12.5</td>' in (tmp_path / "report.html").read_text()


def test_words_in_brackets_are_printed_as_they_are():
    named = record_of(AP, 80.0, TABLE, data="my [red] data")
    assert "my [red] data" in text(RobustnessReport(record=named))


@pytest.fixture
def two(tmp_path):
    report = report_of()
    paths = [tmp_path / "first" / "robustness.json", tmp_path / "second" / "robustness.json"]
    for path, record in zip(paths, (report.record, report.baseline), strict=True):
        RobustnessReport(record=record).write(path.parent)
    return paths


def test_two_runs_are_printed_and_drawn_side_by_side(two, tmp_path, capsys):
    page = tmp_path / "both.html"
    page_of_run = two[0].with_name("report.html")
    before = page_of_run.read_text()
    assert main(["robustness", "--compare", *map(str, two), "-o", str(page_of_run)]) == 2
    assert "would change the file" in capsys.readouterr().err
    assert page_of_run.read_text() == before
    assert main(["robustness", "--compare", *map(str, two), "-o", str(page)]) == 0
    shown = capsys.readouterr().out
    assert re.search(r"camera_fog-1 +70\.0 +40\.0 +\+30\.0", shown)
    assert re.search(
        r"average precision, % +80\.0 +66\.0 +0\.82 +60\.0 +42\.0 +0\.70 +0\.57", shown
    )
    drawn = Page(page.read_text())
    assert drawn.links == []
    assert drawn.tags.count("svg") == 1  # of the kind that has several severities


def test_runs_of_different_cases_are_compared_in_those_that_both_have(two, tmp_path):
    few = record_of(AP, 61.0, {"camera_fog": {1: 41.0}})
    RobustnessReport(record=few).write(tmp_path / "few")
    both = compare_runs([two[0], tmp_path / "few" / "robustness.json"])
    assert list(both.records[0].cases) == ["clean", "camera_fog-1"]
    assert list(both.records[1].cases) == ["clean", "camera_fog-1"]
    assert any("not all runs have these cases" in note for note in both.notes())


def test_three_runs_are_compared_each_with_the_first_and_drawn(two, tmp_path, capsys):
    third = record_of(AP, 50.0, TABLE)
    RobustnessReport(record=third).write(tmp_path / "third")
    paths = [*map(str, two), str(tmp_path / "third" / "robustness.json")]
    page = tmp_path / "three.html"
    assert main(["robustness", "--compare", *paths, "-o", str(page)]) == 0
    shown = capsys.readouterr().out
    assert len(re.findall(r"lead over", shown)) == 2
    assert re.search(r"clean +80\.0 +60\.0 +50\.0 +\+20\.0 +\+30\.0", shown)
    drawn = page.read_text()
    assert all(f'class="bar {style}"' in drawn for style in ("ours", "other", "third"))


def test_runs_of_one_name_are_numbered_wherever_the_page_and_the_tables_name_them(tmp_path):
    records = tuple(record_of(AP, first, TABLE) for first in (80.0, 60.0))
    runs = Comparison(records=records)
    runs.write(tmp_path / "both.html")
    words = Page((tmp_path / "both.html").read_text()).words
    assert "toy" not in words
    assert words.count("toy (2)") == words.count("toy (1)") == 2  # heading and legend
    assert "toy (1) and toy (2)" in words  # the title
    assert any("by toy (1), 2 frames" in each and "and by toy (2)" in each for each in words)
    assert "by toy (1), 2 frames" in text(runs)


def test_notes_of_a_run_come_back_from_its_file_and_stand_in_every_report(two, tmp_path):
    note = "With fewer than 41 objects read all points."
    few = replace(record_of(AP, 61.0, TABLE), notes=(note,))
    report = RobustnessReport(record=few, absent_cases=("lidar_blank",))
    report.write(tmp_path / "few")
    assert read_record(tmp_path / "few" / "robustness.json").notes == (note,)
    written = tmp_path / "few"
    page, table = ((written / name).read_text() for name in ("report.html", "robustness.md"))
    for text_ in (page, table, text(report)):
        assert note in " ".join(text_.split())
        assert "1 case of suite levels without results" in " ".join(text_.split())
    both = compare_runs([two[0], tmp_path / "few" / "robustness.json"])
    assert f"toy (2): {note}" in both.notes()
    assert "notes" not in json.loads(two[0].read_text())


def test_runs_are_named_by_their_folders_and_a_folder_without_a_record_is_told(
    two, tmp_path, capsys
):
    folders = [str(path.parent) for path in two]
    assert main(["robustness", "--compare", *folders]) == 0
    by_folders = capsys.readouterr().out
    assert main(["robustness", "--compare", *map(str, two)]) == 0
    assert capsys.readouterr().out == by_folders
    (tmp_path / "empty").mkdir()
    assert main(["robustness", "--compare", folders[0], str(tmp_path / "empty")]) == 2
    said = capsys.readouterr().err
    assert f"{tmp_path / 'empty'}: holds no robustness.json; finish the run, or give" in said


def test_runs_that_do_not_compare_are_refused_in_one_line(two, tmp_path, capsys):
    other = record_of(AP, 61.0, TABLE, suite="others")
    RobustnessReport(record=other).write(tmp_path / "other")
    path = str(tmp_path / "other" / "robustness.json")
    assert main(["robustness", "--compare", str(two[0]), path]) == 2
    err = capsys.readouterr().err
    assert f"the run {path} is of suite others instead of levels" in err
    assert err.count("\n") == 1
    for arguments, message in (
        (["--compare", str(two[0])], "a comparison needs two runs or more, got 1"),
        (["--compare", "x", "y"], "no such file or directory; give the robustness.json of a run"),
        (["out"], "robustness needs a data set"),
        (["--data", "x"], "robustness needs a folder for the run"),
        (["--data", "x", "out", "-o", "page.html"], "--page draws finished runs"),
        (["--data", "x", "out", "--healthy", "radar=A.json"], "--healthy radar=A.json is invalid"),
        (["--data", "x", "out", "--healthy", "lidar=A", "lidar=B"], "two methods of the lidar"),
        (["out", "--compare", str(two[0]), path], "--compare reads finished runs"),
        (["--data", "x", "out", "--results", "y", "z"], "--results is one folder, got y z"),
        (
            ["--data", "x", "out", "--results", "y"],
            "what its files are; name it by --task detection",
        ),
    ):
        try:
            status = main(["robustness", *arguments])
        except SystemExit as exit_:
            status = exit_.code
        assert status == 2
        assert message in capsys.readouterr().err


def test_other_files_under_the_same_name_cause_a_warning_in_comparisons(tmp_path):
    def record(digest):
        return record_of(AP, 80.0, TABLE, files_digest=digest)

    paths = []
    for number, digest in enumerate(("0123", "4567", None)):
        RobustnessReport(record=record(digest)).write(tmp_path / str(number))
        paths.append(tmp_path / str(number) / "robustness.json")
    shown = "data kitti/toy hold other files, by names or sizes, for toy (2) than for toy (1)"
    assert shown in " ".join(compare_runs(paths).notes())
    assert compare_runs([paths[0], paths[2]]).notes() == ()  # a record of before does not know
    again = compare_runs([paths[0], paths[1], paths[0]]).notes()
    assert sum("toy (3) is the run of toy (1), with the same scores" in note for note in again) == 1
    baseline = replace(record("0123"), method="other")
    healthy = {"lidar": record("89")}
    one = RobustnessReport(record=record("0123"), baseline=baseline, healthy=healthy)
    assert "for the healthy lidar than for this run" in " ".join(one.notes())
    assert replace(one, healthy={}).notes() == ()


@pytest.mark.parametrize(
    "change",
    [
        {"figures": []},
        {"frames": -1},
        {"seed": 10**400},
        {"method": ["a", "list"]},
        {"cases": {}},
        {"scores": {"clean": {"ap": math.inf}}},
        {"scores": {"clean": {"ap": 1e308}}},
    ],
)
def test_a_forged_record_is_refused_in_one_line(tmp_path, change):
    content = record_of(AP, 50.0, {}).to_json() | change
    (tmp_path / "robustness.json").write_text(json.dumps(content))
    with pytest.raises(
        FileError, match=r"robustness\.json: is no record of a robustness run"
    ) as it:
        read_record(tmp_path / "robustness.json")
    assert str(it.value).isprintable()


def test_text_of_a_record_holds_nothing_that_steers_a_screen_or_a_page(tmp_path):
    content = record_of(AP, 50.0, {}).to_json() | {"method": "a\x1b[2J\n| <script>"}
    (tmp_path / "robustness.json").write_text(json.dumps(content))
    record = read_record(tmp_path / "robustness.json")
    assert record.method == r"a\x1b[2J | <script>"
    table = TextTable(title="", header=("method",), rows=((record.method,),))
    assert r"| a\x1b[2J \| &lt;script> |" in table.markdown()

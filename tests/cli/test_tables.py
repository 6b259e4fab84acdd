"""Printed tables of reports: all figures are in the text, however narrow the terminal is."""

import re
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console, Group
from rich.table import Table

from sightline.cli.output import show_table
from sightline.cli.tables import fitted
from sightline.evaluation.calibration import ScoredFrames, evaluate_calibration
from sightline.evaluation.held_out import HeldOutReport, HeldOutScore
from sightline.evaluation.kitti_object_comparison import (
    ComparedEntry,
    ObjectComparison,
    PairedDifference,
)
from sightline.evaluation.kitti_object_rules import DIFFICULTIES
from sightline.health.report import HealthReport
from sightline.robustness.compare import Comparison
from sightline.robustness.report import RobustnessReport
from sightline.structures.health import Alarms, FrameHealth, Health, SampleHealth
from tests.evaluation.kitti_scenes import random_street, write_frames
from tests.robustness.runs import AP, RMSE, record_of

WIDTHS = (40, 60, 80, 100, 160)
LONG_NAME = "n015-2018-07-24-11-22-45+0800__CAM_FRONT__{:016d}"
KINDS = ("camera_fog", "camera_low_resolution", "lidar_rain")


def record(metric, first, name="detection2d-best"):
    table = {
        kind: {level: first - 7.3 * level - 0.1 * n for level in range(1, 6)}
        for n, kind in enumerate(KINDS)
    }
    return replace(record_of(metric, first, table), method=name)


def run(metric, first):
    healthy = {"lidar": record(metric, first - 3.2, "lidar-alone")}
    baseline = record(metric, first - 11.1, "detection2d-fast-cpu")
    return RobustnessReport(record=record(metric, first), baseline=baseline, healthy=healthy)


def comparison(*names):
    title = "Pedestrian, 2D IoU 0.5, moderate, AP, all points"
    metric = replace(AP, title=title)
    return Comparison(
        records=tuple(record(metric, 88.8 - 5.7 * n, name) for n, name in enumerate(names))
    )


def health():
    sound = Health(score=0.93, worst_check="dark")
    frames = [
        FrameHealth(
            health=SampleHealth(
                sample_id=LONG_NAME.format(n),
                camera=sound,
                lidar=Health(score=0.17 + 0.01 * n, worst_check="cluttered"),
                alignment=sound,
                yaw_deg=-0.25 - 0.01 * n,
                camera_regions=np.zeros((1, 2), bool),
                lidar_regions=np.zeros((1, 2), bool),
                blind_sectors=np.zeros(3, bool),
            ),
            alarms=Alarms(camera=True, lidar=True, alignment=True),
        )
        for n in range(5)
    ]
    return HealthReport(frames=tuple(frames))


def objects():
    pair = PairedDifference(first=100.0, second=23.4, difference=76.6, low=-51.9, high=100.0)
    entries = tuple(
        ComparedEntry(
            class_name="Pedestrian", metric="bbox", difficulty=each, n_gt=1234, r40=pair,
            all_points=replace(pair, second=12.3 + n),
        )
        for n, each in enumerate(DIFFICULTIES)
    )  # fmt: skip
    return ObjectComparison(first="mine", second="b", frames=50, num_resamples=9, entries=entries)


def held_out():
    score = HeldOutScore(
        beams=64,
        rmse_mm=11234.0,
        mae_mm=3456.0,
        median_mm=78.0,
        coverage=0.987,
        milliseconds=1234.5,
    )
    return HeldOutReport(scores=(score, replace(score, beams=16)), frames=())


REPORTS = {
    "robustness": lambda: run(replace(AP, title="Car, 2D IoU 0.7, moderate, AP, all points"), 80.0),
    "robustness of depth": lambda: run(RMSE, 4117.3),
    "compared runs": lambda: comparison("detection2d-best", "detection2d-fast-cpu", "others"),
    "compared runs of one name": lambda: comparison("found", "found", "found"),
    "health": health,
    "objects against others": objects,
    "held-out": held_out,
}


def tables_of(content):
    return content.renderables if isinstance(content, Group) else [content]


def words_of(report):
    """Words of all columns at the right: figures, and what stands beside them."""
    tables = [each for each in tables_of(report.table()) if isinstance(each, Table)]
    return Counter(
        word
        for table in tables
        for column in table.columns
        for cell in column.cells
        if column.justify == "right"
        for word in str(cell).split()
    )


def printed(content, width):
    console = Console(width=width)
    with console.capture() as captured:
        console.print(Group(*fitted(content, console)), crop=False)
    return captured.get()


def check_whole(report, text):
    shown = Counter(re.sub("[│┃]", " ", text).split())
    assert words_of(report) - shown == Counter()
    assert "…" not in text


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("name", REPORTS)
def test_no_figure_of_a_table_is_shortened_or_lost(name, width):
    report = REPORTS[name]()
    text = printed(report.table(), width)
    check_whole(report, text)
    if width >= 60:
        assert max(map(len, text.splitlines())) <= width


@pytest.mark.parametrize("width", WIDTHS)
def test_no_figure_of_calibrations_is_lost(tmp_path, width):
    street = [(truth, re.sub(r"\S+\n", "0.5\n", found)) for truth, found in random_street(1, 12)]
    results, labels = write_frames(tmp_path, street)
    report = evaluate_calibration(ScoredFrames(results_dir=results, labels_dir=labels))
    check_whole(report, printed(report.table(), width))


@pytest.mark.parametrize("name", REPORTS)
def test_figures_are_whole_in_a_terminal_and_where_there_is_none(name, monkeypatch, capsys):
    report = REPORTS[name]()
    show_table(report.table())
    check_whole(report, capsys.readouterr().out)
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "80")
    show_table(report.table())
    text = re.sub(r"\x1b\[[0-9;]*m", "", capsys.readouterr().out)
    check_whole(report, text)
    assert max(map(len, text.splitlines())) <= 80


def test_figures_are_whole_in_a_terminal_without_a_size(monkeypatch, capsys):
    report = next(iter(REPORTS.values()))()
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "0")
    show_table(report.table())
    check_whole(report, re.sub(r"\x1b\[[0-9;]*m", "", capsys.readouterr().out))


@pytest.mark.parametrize("name", REPORTS)
def test_a_table_that_fits_is_printed_as_it_is(name):
    content = REPORTS[name]().table()
    console = Console(width=400)
    assert fitted(content, console) == list(tables_of(content))


def test_texts_that_wrap_between_words_are_left_to_rich():
    table = Table("name", "figure")
    table.add_row("a name of many words", "1.25")
    for width in (40, 22, 20):
        assert fitted(table, Console(width=width)) == [table]
    assert fitted(table, Console(width=18)) != [table]
    assert {"words", "figure", "1.25"} <= set(printed(table, 18).replace("┃", "│").split())


def test_a_table_of_names_alone_is_folded():
    table = Table("name")
    table.columns[0].no_wrap = True
    table.add_row("a_name_of_many_letters_and_more")
    assert "a_name_of_many_letters_and_more" in "".join(re.findall(r"\w+", printed(table, 30)))


def test_columns_of_one_run_stay_in_one_part_below_the_title_and_the_notes_come_last():
    table = Table(title="all", caption="notes")
    table.add_column("metric")
    for run_name in ("first", "second"):
        for measure in ("clean", "mPC"):
            table.add_column(f"{measure}, {run_name}", justify="right", no_wrap=True)
    table.add_row("a_metric_of_a_name", "11.1", "22.2", "33.3", "44.4")
    parts = fitted(table, Console(width=56))
    heads = [[str(column.header) for column in part.columns] for part in parts]
    assert heads == [
        ["metric", "clean, first", "mPC, first"],
        ["metric", "clean, second", "mPC, second"],
    ]
    assert [(part.title, part.caption) for part in parts] == [("all", None), (None, "notes")]
    assert (table.title, table.caption) == ("all", "notes")


def test_compared_runs_can_be_told_apart_in_every_part():
    names = ("detector-of-one-team", "detector-of-other-team", "found", "found")
    text = printed(comparison(*names).table(), 80)
    assert {"one-team", "(3)", "(4)"} <= set(text.split())
    assert "other-team" in "".join(text.split())

import io
import types

import pytest
from rich.console import Console

from sightline.training import progress
from sightline.training.progress import RunProgress


@pytest.fixture
def clock(monkeypatch):
    """Clock that stands still unless it is set."""
    now = types.SimpleNamespace(s=0.0)
    monkeypatch.setattr(progress.time, "monotonic", lambda: now.s)
    return now


def test_lines_tell_rate_and_time_left_now_and_again(clock, capsys):
    lines = progress.ProgressLines()
    for done in range(101):
        clock.s = 0.5 * done
        lines.show("training", done, 200, f"loss {done}")
    assert capsys.readouterr().err.splitlines() == [
        "training: 0 of 200, loss 0",
        "training: 10 of 200, loss 10, 2.00/s, 0:01:35 left",
        "training: 70 of 200, loss 70, 2.00/s, 0:01:05 left",
    ]


def test_a_resumed_run_counts_its_rate_from_where_it_went_on(clock, capsys):
    lines = progress.ProgressLines()
    lines.show("training", 90, 100)
    clock.s = 10.0
    lines.show("training", 95, 100)
    assert capsys.readouterr().err.splitlines()[-1] == "training: 95 of 100, 0.50/s, 0:00:10 left"


def test_a_job_that_comes_again_begins_anew_and_an_endless_one_has_no_end(clock, capsys):
    lines = progress.ProgressLines()
    lines.show("validation", 0, 3)
    lines.end("validation")
    lines.show("validation", 0, None)
    clock.s = 6.0
    lines.show("validation", 3, None)
    assert capsys.readouterr().err.splitlines() == [
        "validation: 0 of 3",
        "validation: 0 of ?",
        "validation: 3 of ?, 0.50/s",
    ]


def test_bars_show_every_job_and_keep_what_is_said():
    file = io.StringIO()
    bars = progress._Bars(Console(file=file, force_terminal=True, width=100))
    bars.show("training", 3, 10, "loss 0.5")
    bars.show("validation", 1, 2)
    bars.say("step 3: validation/rmse_mm 1032 [mm]")
    bars.end("validation")
    bars.close()
    output = file.getvalue()
    assert "training, loss 0.5" in output
    assert "3/10" in output
    assert "step 3: validation/rmse_mm 1032 [mm]" in output


def test_a_process_that_is_not_the_first_shows_nothing(capsys):
    run_progress = RunProgress()
    run_progress.disable()
    run_progress._show("training", 0, 10)
    assert capsys.readouterr().err == ""
    run_progress.enable()
    run_progress._show("training", 0, 10)
    assert capsys.readouterr().err == "training: 0 of 10\n"

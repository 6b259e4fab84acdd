import io
import sys

import pytest

from sightline.jobs import progress
from sightline.jobs.progress import track


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_nothing_is_printed_for_a_short_job_where_stderr_is_no_terminal(capsys):
    assert list(track(range(3), description="scoring")) == [0, 1, 2]
    captured = capsys.readouterr()
    assert captured.out == captured.err == ""


def test_a_long_job_says_now_and_then_how_far_it_is_where_stderr_is_no_terminal(
    monkeypatch, capsys
):
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    for _ in track(range(100), description="scoring"):
        now[0] += 1
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.splitlines() == [
        "scoring: 10 of 100, 1.00/s, 0:01:30 left",
        "scoring: 40 of 100, 1.00/s, 0:01:00 left",
        "scoring: 70 of 100, 1.00/s, 0:00:30 left",
    ]


def test_a_terminal_sees_description_count_and_total_on_stderr(monkeypatch, capsys):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys, "stderr", Terminal())
    assert list(track(iter("abc"), description="scoring", total=3)) == ["a", "b", "c"]
    assert "scoring" in sys.stderr.getvalue()
    assert "3/3" in sys.stderr.getvalue()
    assert capsys.readouterr().out == ""


def test_items_are_drawn_one_at_a_time():
    drawn = []

    def items():
        for item in range(3):
            drawn.append(item)
            yield item

    tracked = track(items(), description="reading")
    assert next(tracked) == 0
    assert drawn == [0]


def test_an_error_while_working_passes_through(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys, "stderr", Terminal())

    def items():
        yield 1
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        list(track(items(), description="reading"))

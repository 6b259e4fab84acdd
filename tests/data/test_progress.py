import io
import sys

import pytest

from sightline.data.progress import track


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_nothing_is_shown_where_stderr_is_no_terminal(capsys):
    assert list(track(range(3), description="scoring")) == [0, 1, 2]
    shown = capsys.readouterr()
    assert shown.out == shown.err == ""


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

import ast
import os
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from rich.table import Table

import sightline.cli
from sightline.cli.output import (
    fail,
    first_of_each_kind,
    format_warning,
    gathered_warnings,
    say,
    show_table,
)
from sightline.data.formats.map_png import write_depth_png

FORGED = "000001\x1b[2J\x1b]0;owned\x07\nno problems\u202e\udce9"


def lines_of(text):
    assert all(each.isprintable() for each in text.split("\n"))
    return text.splitlines()


def test_a_printed_line_stays_one_line_and_shows_control_characters(capsys):
    say(f"  {FORGED}", "next")
    first, second = lines_of(capsys.readouterr().out)
    assert first == r"  000001\x1b[2J\x1b]0;owned\x07\nno problems\u202e\udce9"
    assert second == "next"


def test_errors_and_warnings_are_one_line_each(capsys):
    assert fail(FORGED, 2) == 2
    (line,) = lines_of(capsys.readouterr().err)
    assert line == r"sightline: 000001\x1b[2J\x1b]0;owned\x07 no problems\u202e\udce9"
    (warned,) = lines_of(format_warning(FORGED, UserWarning, "file.py", 1))
    assert warned == line.replace("sightline:", "sightline: warning:")


def test_warnings_of_a_command_are_gathered_by_kind_with_their_number(capsys):
    with gathered_warnings():
        for name in ("a", "a", "b", "c"):
            warnings.warn(f"{name}.npy: {ord(name)} points are left out", stacklevel=1)
        warnings.warn("another", stacklevel=1)
        assert not capsys.readouterr().err
    assert lines_of(capsys.readouterr().err) == [
        "sightline: warning: a.npy: 97 points are left out (3 like it)",
        "sightline: warning: another",
    ]


def test_warnings_of_two_sensors_are_two_kinds(capsys):
    with gathered_warnings():
        for data in ("images", "sweeps"):
            text = f"2 of 2 {data} are bad; if so, its scores are meaningless: fit limits"
            warnings.warn(text, stacklevel=1)
        for name in ("a b/c.npy", "d e/f.npy", "sample 000001"):
            warnings.warn(f"{name}: 7 points are left out", stacklevel=1)
    assert lines_of(capsys.readouterr().err) == [
        "sightline: warning: 2 of 2 images are bad; if so, its scores are meaningless: fit limits",
        "sightline: warning: 2 of 2 sweeps are bad; if so, its scores are meaningless: fit limits",
        "sightline: warning: a b/c.npy: 7 points are left out (3 like it)",
    ]


def test_the_first_warning_of_a_kind_is_printed_at_once_and_the_others_are_counted(capsys):
    with first_of_each_kind():
        warnings.simplefilter("always")
        for name in ("a", "a", "b", "c"):
            warnings.warn(f"{name}.npy: {ord(name)} points are left out", stacklevel=1)
        first = "sightline: warning: a.npy: 97 points are left out"
        assert lines_of(capsys.readouterr().err) == [first]
        warnings.warn("another\n", stacklevel=1)
        warnings.warn("of 1 maps", stacklevel=1)
        warnings.warn("of 2 maps", stacklevel=1)
    assert lines_of(capsys.readouterr().err) == [
        "sightline: warning: another",
        "sightline: warning: of 1 maps",
        "sightline: warning: 2 more like this: a.npy: 97 points are left out",
        "sightline: warning: of 2 maps",
    ]


@pytest.mark.parametrize("terminal", [False, True])
def test_a_table_shows_control_characters_of_its_cells(capsys, monkeypatch, terminal):
    table = Table("name")
    table.add_row("A\x1b]0;owned\x07", style="red")
    if terminal:
        monkeypatch.setenv("FORCE_COLOR", "1")
    show_table(table)
    shown = capsys.readouterr().out
    assert r"A\x1b]0;owned" in shown
    assert "\x1b]" not in shown
    assert ("\x1b[31m" in shown) == terminal


def test_every_printed_line_of_the_commands_goes_this_way():
    folder = Path(sightline.cli.__file__).parent
    calls = {
        path.name
        for path in folder.glob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "print"
    }
    assert calls == {"output.py"}


def shell(command, folder):
    """Run a shell command, with the `sightline` command in place of the braces."""
    words = ["sh", "-c", command.format(f"'{sys.executable}' -m sightline")]
    environment = {name: text for name, text in os.environ.items() if name != "PYTHONUNBUFFERED"}
    return subprocess.run(
        words,
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )


@pytest.mark.parametrize("closed", ["2>&-", "0<&- 1>&- 2>&-", "2>/dev/full"])
def test_an_error_without_a_place_to_print_it_keeps_its_exit_status(tmp_path, closed):
    done = shell(f"{{}} chekc {closed}", tmp_path)  # refused before the heavy imports
    assert (done.returncode, done.stdout, done.stderr) == (2, "", "")


def test_closed_streams_leave_no_descriptor_to_files(tmp_path):
    (tmp_path / "program.py").write_text(
        "import os; from sightline import __main__\n"
        "__main__._open_standard_streams()\n"
        "with open('state', 'w') as state:\n"
        "    print(state.fileno() > 2, [os.fstat(each).st_rdev for each in range(3)], file=state)\n"
    )
    shell(f"'{sys.executable}' program.py <&- >&- 2>&-", tmp_path)
    null = Path(os.devnull).stat().st_rdev
    assert (tmp_path / "state").read_text() == f"True {[null] * 3}\n"


@pytest.mark.parametrize("command", ["tasks", "evaluate depth a.png b.png"])
def test_output_that_cannot_be_written_is_reported_with_its_reason(tmp_path, command):
    for name in "ab":
        write_depth_png(tmp_path / f"{name}.png", np.full((3, 4), ord(name)))
    done = shell(f"{{}} {command} > /dev/full", tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith("sightline: standard output cannot be written: no space")


def test_a_deleted_folder_is_reported(tmp_path):
    done = shell("mkdir gone; cd gone; rmdir ../gone; {} check .", tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith("sightline: the current folder no longer exists")

import os
import re

import pytest

from sightline.cli.config_files import with_config_first
from sightline.cli.main import main
from sightline.files.problem import FileError


def scored(data: str, *, beams: int = 64, min_score: float = 0.1):
    """Stand for a command."""


COMMANDS = {"show": scored, "evaluate": {"_help": "Score results.", "held-out": scored}}


@pytest.mark.parametrize("words", [["--config", "c.yaml"], ["--config=c.yaml"]])
@pytest.mark.parametrize("command", [["show"], ["evaluate", "held-out"]])
def test_settings_of_a_file_come_before_all_others(words, command):
    given = [*command, "DATA", *words, "--beams", "8"]
    expected = [*command, "--config=c.yaml", "DATA", "--beams", "8"]
    assert with_config_first(given, COMMANDS) == expected


@pytest.mark.parametrize(
    "words",
    [[], ["--config", "c.yaml"], ["evaluate"], ["nothing", "--config"], ["show", "--config"]],
)
def test_other_words_stay(words):
    assert with_config_first(words, COMMANDS) == words


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("beam: 8", "has the setting beam, which the command lacks; perhaps beams is meant"),
        ("min-score: 0.5", "has the setting min-score, which the command lacks; perhaps min_score"),
        (
            "video: v.mp4",
            "has the setting video, which the command lacks; expected data, beams, min",
        ),
    ],
)
def test_a_setting_that_the_command_lacks_is_named_with_its_file(tmp_path, line, said):
    path = tmp_path / "c.yaml"
    path.write_text(f"data: D\n{line}\n")
    with pytest.raises(FileError, match=f"^{re.escape(f'{path}: {said}')}"):
        with_config_first(["evaluate", "held-out", "--config", str(path)], COMMANDS)
    assert main(["evaluate", "held-out", "--config", str(path)]) == 2


def test_a_setting_of_a_pipe_that_the_command_lacks_is_told(capsys):
    source, sink = os.pipe()
    with os.fdopen(source, "rb"), os.fdopen(sink, "wb") as file:
        file.write(b"worker: 1")
        file.close()
        given = ["predict", "detection2d", "D", "OUT", "--config", f"/dev/fd/{source}"]
        with pytest.raises(SystemExit, match="2"):
            main(given)
    assert "--config has a setting that predict does not take" in capsys.readouterr().err


def test_the_command_line_replaces_settings_of_a_file(tmp_path, capsys):
    path = tmp_path / "c.yaml"
    path.write_text(f"data: {tmp_path / 'wrong'}\nworkers: 1\n")
    assert main(["check", str(tmp_path / "right"), "--config", str(path)]) > 0
    told = "".join(capsys.readouterr())
    assert "right" in told
    assert "wrong" not in told

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
    [[], ["--help"], ["evaluate"], ["nothing", "--config"], ["show", "--config"]],
)
def test_other_words_stay(words):
    assert with_config_first(words, COMMANDS) == words


@pytest.mark.parametrize(
    ("words", "example"),
    [
        (["--config", "c.yaml", "show"], "sightline COMMAND --config FILE"),
        (["--config=c.yaml"], "sightline COMMAND --config FILE"),
        (["--print_config", "show"], "sightline COMMAND --print_config"),
        (["evaluate", "--config", "c.yaml"], "sightline evaluate COMMAND --config FILE"),
    ],
)
def test_files_of_settings_before_the_command_are_refused(capsys, words, example):
    with pytest.raises(ValueError, match=f"give it behind, as in {re.escape(example)}$"):
        with_config_first(words, COMMANDS)
    assert main(words) == 2
    assert capsys.readouterr().err.count("\n") == 1
    for command in ([], ["evaluate"]):
        with pytest.raises(SystemExit, match="0"):
            main([*command, "--help"])
        assert "--config CONFIG" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("command", "settings", "told"),
    [
        ("show", "data: D\nframes: [000010]", "frames in a file of settings: expected a name"),
        ("show", "data: D\nframes: 000010", "FRAMES in a file of settings: expected a list"),
        ("check", "data: 010", "data in a file of settings: expected a name"),
        ("health", "data: D\nsample_list: 010", "sample_list in a file of settings: expected a na"),
        ("robustness", "data: D\ncases: [1.50]", "expected a name, got what YAML reads as another"),
        ("robustness", "out_folder: 010", "out_folder in a file of settings: expected a name"),
    ],
)
def test_values_that_yaml_reads_as_others_are_refused(tmp_path, capsys, command, settings, told):
    (tmp_path / "c.yaml").write_text(settings)
    with pytest.raises(SystemExit, match="2"):
        main([command, "--config", str(tmp_path / "c.yaml")])
    error = capsys.readouterr().err
    assert told in error
    assert error.count("\n") == 1


@pytest.mark.parametrize("settings", ["", "[a, b]", "# a comment alone", "word"])
@pytest.mark.parametrize("command", ["check", "fit"])
def test_a_file_without_settings_is_named(tmp_path, capsys, command, settings):
    path = tmp_path / "c.yaml"
    path.write_text(settings)
    assert main([command, "--config", str(path)]) == 2
    assert capsys.readouterr().err.startswith(f"sightline: {path}: holds no settings; write a line")


def test_settings_on_the_command_line_itself_that_are_none_are_refused(capsys):
    with pytest.raises(SystemExit, match="2"):
        main(["check", "--config=[a, b]"])
    assert "--config names a file without settings" in capsys.readouterr().err


def test_a_number_of_thousands_of_digits_is_told_with_its_file(tmp_path):
    path = tmp_path / "c.yaml"
    path.write_text(f"beams: {'9' * 5000}\n")
    with pytest.raises(FileError, match=rf"^{re.escape(str(path))}: .*; correct the settings$"):
        with_config_first(["show", "--config", str(path)], COMMANDS)


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


@pytest.mark.parametrize("words", [["--json", "c.json"], ["--json=./c.json"], []])
def test_an_output_that_would_replace_the_settings_is_refused(tmp_path, monkeypatch, capsys, words):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "c.json").write_text('{"data": "drive"}' if words else '{"json": "c.json"}')
    assert main(["check", "--config", "c.json", *words]) == 2
    assert "--config c.json is also" in capsys.readouterr().err


def test_a_setting_of_a_pipe_that_the_command_lacks_is_told(capsys):
    source, sink = os.pipe()
    with os.fdopen(source, "rb"), os.fdopen(sink, "wb") as file:
        file.write(b"worker: 1")
        file.close()
        given = ["predict", "detection2d", "D", "OUT", "--config", f"/dev/fd/{source}"]
        assert main(given) == 2
    told = "has the setting worker, which the command lacks; perhaps workers is meant"
    assert told in capsys.readouterr().err


def test_settings_of_a_pipe_are_read(capsys):
    source, sink = os.pipe()
    with os.fdopen(source, "rb"), os.fdopen(sink, "wb") as file:
        file.write(b"data: nowhere\njson: x.json")
        file.close()
        assert main(["check", "--config", f"/dev/fd/{source}"]) == 2
    assert capsys.readouterr().err.startswith("sightline: nowhere: does not exist")


def test_a_pipe_without_settings_is_not_waited_for(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("sightline.files.plain_file._TIMEOUT_S", 0.1)
    os.mkfifo(tmp_path / "settings")
    assert main(["check", "--config", str(tmp_path / "settings")]) == 2
    assert "gives nothing for 0.1 s" in capsys.readouterr().err


def test_a_place_that_may_be_left_out_is_not_lost_in_a_pipe(capsys):
    source, sink = os.pipe()
    with os.fdopen(source, "rb"), os.fdopen(sink, "wb") as file:
        file.write(b"data_set: KITTI")
        file.close()
        with pytest.raises(SystemExit, match="2"):
            main(["serve", "--config", f"/dev/fd/{source}"])
    assert "is a pipe: give DATA_SET on the command line, or a file" in capsys.readouterr().err


def test_the_command_line_replaces_settings_of_a_file(tmp_path, capsys):
    path = tmp_path / "c.yaml"
    path.write_text(f"data: {tmp_path / 'wrong'}\nworkers: 1\n")
    assert main(["check", str(tmp_path / "right"), "--config", str(path)]) > 0
    told = "".join(capsys.readouterr())
    assert "right" in told
    assert "wrong" not in told

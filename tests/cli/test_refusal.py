import pytest

from sightline.cli.main import main


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            "evaluate objects R L --bootstrap 2.5",
            "--bootstrap: expected a whole number, got 2.5; see sightline evaluate objects --help",
        ),
        (
            "evaluate proposals R L --max-proposals many",
            "--max-proposals: expected a whole number, got many; "
            "see sightline evaluate proposals --help",
        ),
        (
            "evaluate calibration R L --min-score high",
            "--min-score: expected a number, got high; see sightline evaluate calibration --help",
        ),
        (
            "predict depth-completion D OUT --engine fast",
            "--engine: expected one of auto, torch, onnxruntime, openvino, got fast; "
            "see sightline predict depth-completion --help",
        ),
        (
            "evaluate held-out D --method cubic",
            "--method: expected one of nearest, linear, classical, adaptive, got cubic; "
            "see sightline evaluate held-out --help",
        ),
        (
            "evaluate objects R",
            "evaluate objects needs LABELS; see sightline evaluate objects --help",
        ),
        (
            "evaluate objects",
            "evaluate objects needs RESULTS and LABELS; see sightline evaluate objects --help",
        ),
        ("check", "check needs DATA; see sightline check --help"),
        (
            "evaluate",
            "evaluate needs a command: objects, proposals, calibration, depth, held-out, ...; "
            "see sightline evaluate --help",
        ),
        (
            "evaluate object R L",
            "there is no command evaluate object; name one of objects, proposals, calibration, "
            "depth, held-out, realism; see sightline evaluate --help",
        ),
        (
            "evaluate objects R L --plot P",
            "unrecognized arguments: --plot P; see sightline evaluate objects --help",
        ),
    ],
)
def test_a_command_that_is_not_understood_is_answered_in_its_own_words(words, message, capsys):
    with pytest.raises(SystemExit) as ended:
        main(words.split())
    assert ended.value.code == 2
    assert capsys.readouterr().err == f"sightline: {' '.join(message.split())}\n"


@pytest.mark.parametrize(
    "words",
    [
        ["evaluate", "objects", "R", "L", "--json", "-"],
        ["evaluate", "depth", "P", "T", "--json=-"],
        ["predict", "depth-completion", "-", "OUT"],
        ["perceive", "D", "OUT", "--video", "-"],
        ["fit", "--config", "-"],
    ],
)
def test_a_dash_is_no_file(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    error = capsys.readouterr().err
    assert "stands for no file" in error
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("", "an argument is empty, probably a variable of the shell without a value"),
        ("--out=", "the value of --out is empty, probably a variable of the shell without a value"),
        ("~/out", "~ stands for the home folder only where the shell replaces it"),
        ("--out=~/out", "~ stands for the home folder only where the shell replaces it"),
    ],
)
def test_words_that_the_shell_did_not_replace_are_no_places(
    word, message, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    assert main(["demo", word]) == 2
    assert message in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []

import os
import threading
from pathlib import Path

import jsonargparse
import pytest

from sightline.cli.main import main
from sightline.cli.parser import OneLineParser

_seen = []


def command(data: str, *, beams: tuple[int, ...] | None = None, ious: tuple[float, ...] = (0.5,)):
    _seen.append((data, beams, ious))


def framed(*, image_size: tuple[int, int] | None = None):
    _seen.append(image_size)


def chosen(*, cases: tuple[str, ...] | None = None):
    _seen.append(cases)


def placed(data: Path, *, out: Path | None = None):
    _seen.append((data, out))


def left_out(*, out_folder: Path | None = None, cases: tuple[str, ...] | None = None):
    _seen.append((out_folder, cases))


def run(function, *arguments):
    jsonargparse.auto_cli(function, args=list(arguments), parser_class=OneLineParser)
    return _seen.pop()


@pytest.mark.parametrize(
    ("words", "numbers"),
    [
        (["--beams", "64"], (64,)),
        (["--beams", "64", "16"], (64, 16)),
        (["--beams", "64,16"], (64, 16)),
        (["--beams=64,16"], (64, 16)),
        (["--beams=[64,16]"], (64, 16)),
        (["--beams", "-8"], (-8,)),
        ([], None),
    ],
)
def test_several_numbers_are_taken_however_people_write_them(words, numbers):
    assert run(command, "DATA", *words) == ("DATA", numbers, (0.5,))


@pytest.mark.parametrize(
    ("setting", "expected"),
    [
        ("beams: 16", ((16,), (0.5,))),
        ("beams: [64, 16]", ((64, 16), (0.5,))),
        ('beams: "64,16"', ((64, 16), (0.5,))),
        ('beams: ["16"]\nious: 1', ((16,), (1.0,))),
        ("ious: [0.5, 0.7]", (None, (0.5, 0.7))),
    ],
)
def test_lists_in_a_file_of_settings_are_those_of_the_command_line(tmp_path, setting, expected):
    path = tmp_path / "c.yaml"
    path.write_text(setting)
    assert run(command, f"--config={path}", "DATA") == ("DATA", *expected)
    assert run(command, f"--config={path}", "DATA", "--beams", "8", "--ious=0.1") == (
        "DATA",
        (8,),
        (0.1,),
    )


@pytest.mark.parametrize("value", ["{a: 1}", "[[1]]", "yes", "sixteen", "1.5"])
def test_other_values_in_a_file_of_settings_are_refused(tmp_path, capsys, value):
    (tmp_path / "c.yaml").write_text(f"beams: {value}")
    with pytest.raises(SystemExit):
        run(command, f"--config={tmp_path / 'c.yaml'}", "DATA")
    told = capsys.readouterr().err
    assert "--beams: expected numbers, got" in told
    assert told.count("\n") == 1


def test_an_optional_place_is_taken_from_a_file_of_settings(tmp_path):
    path = tmp_path / "c.yaml"
    path.write_text("out_folder: there\ncases: clean")
    assert run(left_out, f"--config={path}") == (Path("there"), ("clean",))
    assert run(left_out, f"--config={path}", "here") == (Path("here"), ("clean",))
    assert run(left_out) == (None, None)


def test_numbers_are_of_the_type_and_count_that_the_option_has():
    assert run(command, "DATA", "--ious", "0.5", "0.7") == ("DATA", None, (0.5, 0.7))
    assert run(framed, "--image-size", "1920,1200") == (1920, 1200)
    assert run(framed, "--image-size", "1920", "1200") == (1920, 1200)


@pytest.mark.parametrize(
    "words", [["--cases", "clean", "fog"], ["--cases", "clean,fog"], ["--cases=[clean,fog]"]]
)
def test_several_names_are_taken_however_people_write_them(words):
    assert run(chosen, *words) == ("clean", "fog")
    assert run(chosen) is None


@pytest.mark.parametrize("name", ["run,2", "run[1]"])
def test_names_of_folders_stay_whole(tmp_path, monkeypatch, name):
    (tmp_path / name).mkdir()
    (tmp_path / "c.yaml").write_text(f"cases: ['{name}']")
    monkeypatch.chdir(tmp_path)
    for words in (["--cases", name, "a,b"], [f"--cases={name}"], ["--config=c.yaml"]):
        assert run(chosen, *words)[0] == name


def test_long_lists_of_names_are_split():
    assert len(run(chosen, "--cases", ",".join(["clean"] * 1000))) == 1000


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--beams", "many"], "argument --beams: expected numbers, got many"),
        (["--beams", "64,"], "argument --beams: expected numbers, got 64,"),
        (["--beams", "6.4"], "argument --beams: expected numbers, got 6.4"),
        (["--beams"], "argument --beams: expected at least one argument"),
        (["--beams", "64", "DATA"], "got 64 DATA; write them last or as --beams=1,2"),
    ],
)
def test_what_are_no_numbers_is_refused_in_one_line_that_says_how(capsys, words, message):
    with pytest.raises(SystemExit):
        run(command, "DATA", *words)
    assert message in capsys.readouterr().err
    with pytest.raises(SystemExit):
        run(framed, "--image-size", "1,2,3")
    assert "argument --image-size: expected 2 numbers, got 3" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["donn\udce9es/KITTI", "a\x1b[2J", "a\nb", "été"])
def test_a_path_is_taken_whatever_bytes_its_name_has(name):
    assert run(placed, name, "--out", name) == (Path(name), Path(name))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ("a: " + "[" * 30_000 + "]" * 30_000, "nested more than 50 deep"),  # a segmentation fault
        ("a: " + "[" * 3000 + "]" * 3000, "nested more than 50 deep"),
        (
            "\n".join(
                ["a0: &a0 [x, x, x, x, x, x, x, x]"]
                + [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 8)}]" for n in range(1, 12)]
            ),
            "more than 65536 values",
        ),
    ],
)
def test_settings_that_are_nested_deeply_or_multiply_are_refused_in_one_line(
    tmp_path, capsys, settings, message
):
    path = tmp_path / "settings.yaml"
    path.write_text(settings)
    given = ["predict", "depth-completion", "KITTI", "out", "--config", str(path)]
    assert main(given) == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("settings", "problem"),
    [
        ("out: a\nworkers: 2\nout: b\n", "line 3 has out a second time"),
        ("data: {seed: 1, 'seed': 2}\n", "line 1 has seed a second time"),
        ("data:\n- {a: 1}\n- a: 1\n  b: 2\n  a: 2\n", "line 5 has a a second time"),
        ("out: [1\nworkers: 2\n", "is no YAML: line 2, column 8: "),
    ],
)
@pytest.mark.parametrize("is_pipe", [False, True])
def test_settings_that_stand_twice_or_are_no_yaml_are_refused_with_their_line(
    tmp_path, capsys, settings, problem, is_pipe
):
    path = tmp_path / "settings.yaml"
    if is_pipe:
        os.mkfifo(path)
        threading.Thread(target=path.write_text, args=(settings,)).start()
    else:
        path.write_text(settings)
    assert main(["predict", "depth-completion", "KITTI", "out", "--config", str(path)]) == 2
    told = capsys.readouterr().err
    assert told.startswith(f"sightline: {path}: {problem}")
    assert "; correct the settings" in told


def test_settings_of_a_training_that_stand_twice_are_refused(tmp_path, capsys):
    path = tmp_path / "mine.yaml"
    path.write_text("trainer:\n  max_epochs: 1\n  precision: 32\n  max_epochs: 2\n")
    assert main(["fit", "--config", str(path), "--run_folder", str(tmp_path / "run")]) == 2
    assert f"sightline: {path}: line 4 has max_epochs a second time" in capsys.readouterr().err


def test_several_merges_in_a_mapping_are_taken(tmp_path, capsys):
    path = tmp_path / "settings.yaml"
    path.write_text("x: &x {data: KITTI}\ny: &y {out: o}\nz:\n  <<: *x\n  <<: *y\n")
    assert main(["predict", "depth-completion", "--config", str(path)]) == 2
    assert "has the setting x, which the command lacks" in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--config", "-c"])
def test_settings_of_a_training_that_are_too_large_are_refused_before_they_are_read(
    tmp_path, capsys, option
):
    path = tmp_path / "large.yaml"
    with path.open("wb") as file:
        file.truncate(2**35)
    assert main(["fit", option, str(path), "--run_folder", str(tmp_path / "run")]) == 2
    assert f"sightline: {path}: is {2**35} bytes long, expected up to" in capsys.readouterr().err

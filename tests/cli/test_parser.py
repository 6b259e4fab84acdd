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
    with pytest.raises(SystemExit):
        main(["predict", "depth-completion", "KITTI", "out", "--config", str(path)])
    assert message in capsys.readouterr().err
